/**
 * How a world looks: daylight, or one of the views that show how it is made.
 *
 *     const look = new Look(renderer, scene, { seedOrRecipeName: "planet", voxelSize: 1, isPlanet: true, ... });
 *     group.add(new ChunkObject(mesh, look.materialFor(mesh)));
 *     look.update(camera, group.anchor, up, seconds);
 *     look.render(camera);
 *
 * It adds a sky to the scene, and finds the chunks in it by itself.
 */

import type { ChunkMesh } from "chunkserver-client";
import {
  ACESFilmicToneMapping,
  Color,
  Scene,
  SRGBColorSpace,
  Vector2,
  Vector3,
  Vector4,
  type Camera,
  type Material,
  type PerspectiveCamera,
  type WebGLRenderer,
} from "three";

import { airUniforms, type AirUniforms } from "./air.js";
import { STREETS_PERIOD } from "./city.js";
import { drift, type CloudUniforms } from "./clouds.js";
import { Globe } from "./globe.js";
import { definesOf, groundMaterial, type GroundUniforms } from "./ground.js";
import { fill, inTasks, noNoise, rockNoise, soilNoise, textureOf } from "./noise.js";
import { Openness } from "./openness.js";
import { groundOf, type Ground } from "./palette.js";
import { remainder } from "./period.js";
import { qualityOf, type Quality } from "./quality.js";
import { blow, type SeaUniforms } from "./sea.js";
import { Shadows } from "./shadows.js";
import { Sky } from "./sky.js";
import { sunFor } from "./sun.js";
import { chunksOf, signatureOf, surveyOf, type Survey } from "./survey.js";
import { BACKGROUND, cellUnitsOf, viewMaterials, type ViewMaterials } from "./views.js";

export type View = "shaded" | "wireframe" | "levels" | "normals";

/** What a look depends on. */
export interface LookWorld {
  /** Of a built-in recipe; any other text looks like meadows. */
  readonly seedOrRecipeName: string;
  /** Metres. */
  readonly voxelSize: number;
  readonly isPlanet: boolean;
  /** Of a planet, voxels. */
  readonly centre: readonly [number, number, number] | null;
  readonly radius: number | null;
}

/** Metres: how far one sees before anything is there to be seen, and at least. */
const VISIBILITY_FIRST = 600;
const VISIBILITY_LEAST = 160;
/** Beyond it there is haze even where more is drawn; further from the ground one sees further. */
const VISIBILITY_MOST = 2400;
const VISIBILITY_BY_HEIGHT = 5;
const SHADOW_SIZE = 2048;
/** Metres: nobody's eye is just in the surface of the sea. */
const SEA_LEAST = 0.02;
/** Milliseconds between two drawings of a map while chunks come in. */
const MAP_EACH_MS = 120;

/** The same for all worlds: made for the first. */
let noises: Promise<Noises> | null = null;

interface Noises {
  readonly rock: Uint8Array;
  readonly soil: Uint8Array;
}

async function makeNoises(): Promise<Noises> {
  return { rock: await inTasks(rockNoise(1)), soil: await inTasks(soilNoise(2)) };
}

export class Look {
  readonly quality: Quality;
  /** Whether there is rock above the viewer: asked below the level of the sea, which does not come into caves. */
  isCovered: () => boolean = () => false;
  /** Resolves when the ground has its noise: the picture is another one then. */
  readonly isDetailed: Promise<void>;
  private view: View = "shaded";
  private readonly ground: Ground;
  private readonly air: AirUniforms;
  private readonly sky: Sky;
  private readonly shadows: Shadows;
  private readonly openness = new Openness();
  private readonly own: GroundUniforms;
  private readonly seaUniforms: SeaUniforms;
  private readonly cloudUniforms: CloudUniforms;
  private readonly globe: Globe;
  private readonly hasGlobe: boolean;
  /** Of the sea, over the radius or y = 0; metres. */
  private readonly seaHeight: number;
  private readonly textures;
  private readonly shaded: Material;
  private readonly views: ViewMaterials;
  private readonly cellUnits = { value: 1024 };
  /** Of the picture, in pixels. */
  private height = 1;
  private readonly sun = new Vector3();
  private survey: Survey | null = null;
  private signature = -1;
  private surveyedAt = new Vector3(Infinity, 0, 0);
  private readonly drawnMaps = [-Infinity, -Infinity, -Infinity];
  /** Voxels. */
  private anchor: readonly [number, number, number] | null = null;

  /** What the maps show is no longer so: chunks have changed, or the graphics card has lost them. */
  private readonly outdate = () => {
    this.shadows.outdate();
    this.openness.outdate();
  };
  private readonly restored = () => {
    this.outdate();
    this.globe.outdate();
  };

  /** @param quality by default what the address asks for (`?quality=high`), or what the graphics card is up to */
  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly scene: Scene,
    private readonly world: LookWorld,
    quality?: Quality,
  ) {
    this.quality = quality ?? qualityOf(renderer.getContext(), globalThis.location?.search ?? "");
    renderer.toneMapping = ACESFilmicToneMapping;
    renderer.toneMappingExposure = 0.36;
    renderer.outputColorSpace = SRGBColorSpace;
    const ground = (this.ground = groundOf(world.seedOrRecipeName));
    const radius = world.isPlanet && world.radius !== null ? world.radius * world.voxelSize : null;
    this.air = airUniforms(radius, ground.airless, ground.air);
    this.seaHeight = (ground.sea ?? 0) * world.voxelSize;
    this.seaUniforms = {
      sea: { value: new Vector2((radius ?? 0) + this.seaHeight, 1) },
      waves: { value: new Vector3() },
    };
    this.cloudUniforms = { clouds: { value: new Vector4((radius ?? 0) * (1 + (ground.clouds ?? 0)), 1, 0, 0) } };
    this.globe = new Globe(this.quality);
    const defines = definesOf(ground, radius !== null, this.quality);
    this.hasGlobe = "CLOUDS" in defines || "CLIMATE" in defines;
    this.shadows = new Shadows(renderer, this.quality === "high" ? SHADOW_SIZE : 1);
    this.own = {
      anchorLeft: { value: new Vector3() },
      streetsLeft: { value: new Vector3() },
      middle: { value: new Vector3() },
      visibility: { value: VISIBILITY_FIRST },
    };
    const anisotropy = this.quality === "high" ? Math.min(8, renderer.capabilities.getMaxAnisotropy()) : 1;
    this.textures = { rock: textureOf(noNoise(), anisotropy), soil: textureOf(noNoise(), anisotropy) };
    noises ??= makeNoises();
    this.isDetailed = noises.then(({ rock, soil }) => {
      fill(this.textures.rock, rock);
      fill(this.textures.soil, soil);
    });
    this.sky = new Sky(scene, this.air, this.quality === "high" ? 24 : 10, {
      uniforms: {
        ...this.own,
        ...this.seaUniforms,
        ...this.cloudUniforms,
        ...this.globe.uniforms,
        soilNoise: { value: this.textures.soil },
      },
      defines: radius === null && !ground.airless ? { ...defines, FLAT: 1 } : defines,
    });
    this.shaded = groundMaterial({
      ground,
      radius,
      own: this.own,
      air: this.air,
      sky: this.sky.uniforms,
      shadow: this.shadows.uniforms,
      openness: this.openness.uniforms,
      sea: this.seaUniforms,
      clouds: this.cloudUniforms,
      globe: this.globe.uniforms,
      ...this.textures,
      voxelSize: world.voxelSize,
      defines,
    });
    this.views = viewMaterials(this.cellUnits);
    renderer.domElement.addEventListener("webglcontextrestored", this.restored);
  }

  /** The same for all chunks of a view; already `placed`. */
  materialFor(chunk: ChunkMesh): Material {
    this.cellUnits.value = cellUnitsOf(chunk);
    const { lines, levels, normals } = this.views;
    return { shaded: this.shaded, wireframe: lines, levels, normals }[this.view];
  }

  /** Whoever has chunks in the scene gives them the materials of the view. */
  setView(view: View): void {
    this.view = view;
  }

  /**
   * Before each frame.
   *
   * @param anchor where the scene's origin is, voxels
   * @param up at the viewer
   * @param seconds since the frame before
   */
  update(camera: PerspectiveCamera, anchor: readonly [number, number, number], up: Vector3, seconds: number): void {
    this.placeWorld(anchor);
    this.look(camera);
    if (this.view !== "shaded") {
      return;
    }
    this.placeSun(camera, up);
    this.placeSea(camera, seconds);
    if (this.hasGlobe) {
      this.globe.update(this.renderer);
    }
    this.sky.update(this.renderer, camera, up, seconds);
    const reach = this.visibilityFrom(camera);
    const visibility = this.own.visibility;
    visibility.value += (reach - visibility.value) * (1 - Math.exp(-2 * seconds));
    if (this.quality === "high" && this.survey !== null) {
      this.drawMaps(this.survey, up);
    }
  }

  resize(_width: number, height: number): void {
    this.height = height;
  }

  render(camera: PerspectiveCamera): void {
    const { renderer, scene } = this;
    this.sky.visible = this.view === "shaded";
    if (this.view === "shaded") {
      renderer.render(scene, camera);
      return;
    }
    const background = scene.background;
    scene.background = BACKGROUND;
    if (this.view === "wireframe") {
      this.draw(camera, this.views.hidden, BACKGROUND);
      scene.background = null;
      const clears = renderer.autoClear;
      renderer.autoClear = false;
      renderer.render(scene, camera);
      renderer.autoClear = clears;
    } else {
      renderer.render(scene, camera);
    }
    scene.background = background;
  }

  dispose(): void {
    this.renderer.domElement.removeEventListener("webglcontextrestored", this.restored);
    this.sky.dispose();
    this.shadows.dispose();
    this.openness.dispose();
    this.globe.dispose();
    this.shaded.dispose();
    Object.values(this.views).forEach((material: Material) => material.dispose());
    Object.values(this.textures).forEach((texture) => texture.dispose());
  }

  private placeWorld(anchor: readonly [number, number, number]): void {
    const { voxelSize, isPlanet, centre } = this.world;
    this.own.anchorLeft.value.set(...remainder(anchor, voxelSize));
    this.own.streetsLeft.value.set(...remainder(anchor, voxelSize, STREETS_PERIOD * voxelSize));
    const [x, y, z] = anchor.map((voxel, axis) => ((centre?.[axis] ?? 0) - voxel) * voxelSize);
    const isRound = isPlanet || this.ground.isRing;
    this.own.middle.value.set(isRound ? x! : 0, y!, isRound ? z! : 0);
    this.air.airCentre.value.set(isPlanet ? x! : 0, isPlanet ? y! : y! - this.air.airShape.value[0], isPlanet ? z! : 0);
    const before = this.anchor ?? anchor;
    const by = new Vector3(...before.map((voxel, axis) => (voxel - anchor[axis]!) * voxelSize));
    if (this.anchor === null || by.lengthSq() > 0) {
      this.anchor = [...anchor];
      this.signature = -1;
      this.shadows.move(by);
      this.openness.move(by);
    }
  }

  /** Looks at what is drawn, if that has changed or the viewer has moved. */
  private look(camera: PerspectiveCamera): void {
    const signature = signatureOf(this.scene);
    const isSame = signature === this.signature;
    if (isSame && this.surveyedAt.distanceTo(camera.position) < this.world.voxelSize) {
      return;
    }
    this.signature = signature;
    this.surveyedAt.copy(camera.position);
    if (!isSame) {
      this.scene.updateMatrixWorld();
      this.outdate();
    }
    this.survey = surveyOf(isSame && this.survey ? this.survey.chunks : chunksOf(this.scene), camera.position);
  }

  private visibilityFrom(camera: PerspectiveCamera): number {
    if (this.survey === null) {
      return VISIBILITY_FIRST;
    }
    const most = VISIBILITY_MOST + VISIBILITY_BY_HEIGHT * this.survey.nearest.distanceTo(camera.position);
    const least = Math.max(VISIBILITY_LEAST, this.ground.clear * this.world.voxelSize);
    return Math.max(Math.min(this.survey.reach, most), least);
  }

  private placeSea(camera: PerspectiveCamera, seconds: number): void {
    const { middle } = this.own;
    const { sea, waves } = this.seaUniforms;
    const height = this.world.isPlanet
      ? camera.position.distanceTo(middle.value) - sea.value.x
      : camera.position.y - middle.value.y - this.seaHeight;
    const isDry = height < 0 && this.isCovered();
    sea.value.y = isDry ? 0 : Math.abs(height) < SEA_LEAST ? SEA_LEAST : height;
    const pixel = (2 * Math.tan((camera.fov * Math.PI) / 360)) / this.height;
    waves.value.z = pixel;
    const { clouds } = this.cloudUniforms;
    clouds.value.w = (pixel * this.globe.texels) / Math.max(clouds.value.x, 1);
    blow(this.seaUniforms, seconds);
    drift(this.cloudUniforms, seconds);
  }

  private placeSun(camera: PerspectiveCamera, up: Vector3): void {
    const { isPlanet, radius, voxelSize } = this.world;
    const height = isPlanet ? camera.position.distanceTo(this.own.middle.value) / ((radius ?? 1) * voxelSize) - 1 : 0;
    const sun = sunFor(this.sun, up, height);
    if (this.air.sunDirection.value.distanceTo(sun) > 1e-3) {
      this.air.sunDirection.value.copy(sun);
      this.shadows.outdate();
    }
  }

  /** One map at most in a frame, so that none takes long; each only now and then while chunks come in. */
  private drawMaps({ nearest, lod }: Survey, up: Vector3): void {
    const sight = {
      focus: nearest,
      voxel: this.world.voxelSize * 2 ** lod,
      draw: (camera: Camera, material: Material) => this.draw(camera, material, null),
    };
    const origin = this.own.anchorLeft.value.clone().negate();
    const { renderer, shadows, air } = this;
    const maps = [
      () => shadows.update("near", renderer, sight, air.sunDirection.value, origin),
      () => this.openness.update(renderer, sight, up),
      () => shadows.update("far", renderer, sight, air.sunDirection.value, origin),
    ];
    const now = performance.now();
    for (const [number, update] of maps.entries()) {
      if (now - this.drawnMaps[number]! > MAP_EACH_MS && update()) {
        this.drawnMaps[number] = now;
        return;
      }
    }
  }

  /** Draws all chunks, and nothing else, with one material. */
  private draw(camera: Camera, material: Material, background: Color | null): void {
    const scene = new Scene();
    scene.children = [...(this.survey?.chunks ?? [])];
    scene.matrixWorldAutoUpdate = false;
    scene.overrideMaterial = material;
    scene.background = background;
    const clears = this.renderer.autoClear;
    this.renderer.autoClear = background !== null;
    this.renderer.render(scene, camera);
    this.renderer.autoClear = clears;
  }
}
