import { placed } from "chunkserver-client/three";
import type { ChunkMesh, Triple } from "chunkserver-client";
import {
  Color,
  DirectionalLight,
  HemisphereLight,
  MeshNormalMaterial,
  MeshStandardMaterial,
  type Material,
  type PerspectiveCamera,
  type Scene,
  type Vector3,
  type WebGLRenderer,
} from "three";

export type View = "shaded" | "wireframe" | "levels" | "normals";
export class Look {
  private readonly material = placed(new MeshStandardMaterial({ color: 0x8d9a78 }));
  private readonly normals = placed(new MeshNormalMaterial());
  private readonly levels = Array.from({ length: 24 }, (_, lod) =>
    placed(new MeshStandardMaterial({ color: new Color().setHSL((lod * 0.17) % 1, 0.6, 0.5) })),
  );
  private view: View = "shaded";
  private readonly sun = new DirectionalLight(0xffffff, 2);
  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly scene: Scene,
    _world: {
      seedOrRecipeName: string;
      voxelSize: number;
      isPlanet: boolean;
      centre: Triple | null;
      radius: number | null;
    },
  ) {
    scene.background = new Color(0x9ec3e6);
    scene.add(this.sun, new HemisphereLight(0xffffff, 0x555555, 1.2));
    this.sun.position.set(1, 1, 0.5);
  }
  materialFor(chunk: ChunkMesh): Material {
    this.material.wireframe = this.view === "wireframe";
    return this.view === "levels"
      ? this.levels[chunk.key.lod]!
      : this.view === "normals"
        ? this.normals
        : this.material;
  }
  setView(view: View): void {
    this.view = view;
  }
  update(_camera: PerspectiveCamera, _anchor: Triple, _up: Vector3, _seconds: number): void {}
  resize(_width: number, _height: number): void {}
  render(camera: PerspectiveCamera): void {
    this.renderer.render(this.scene, camera);
  }
  dispose(): void {
    this.scene.clear();
  }
}
