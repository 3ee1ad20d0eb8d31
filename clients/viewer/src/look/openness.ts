/**
 * How much of the sky is seen from the ground, roughly: the heights of what is seen from straight above, averaged over
 * wider and wider squares, which are the mip levels of one texture. Whatever is lower than the ground around it sees
 * less: the foot of a cliff, a street, the inside of a cave.
 */

import {
  Color,
  HalfFloatType,
  LinearFilter,
  LinearMipmapLinearFilter,
  Matrix4,
  OrthographicCamera,
  RedFormat,
  ShaderMaterial,
  Vector3,
  WebGLRenderTarget,
  type Texture,
  type WebGLRenderer,
} from "three";

import { placed } from "chunkserver-client/three";

import type { Sight } from "./shadows.js";

/** What a shader needs to know how open a place is. */
export interface OpennessUniforms {
  [name: string]: { value: unknown };
  heights: { value: Texture };
  /** From the scene to the map, 0 to 1, and to the height in metres. */
  heightsMatrix: { value: Matrix4 };
  /** Width of a texel in metres; 0 where there is no map. */
  heightsTexel: { value: number };
}

const SIZE = 512;
/** Half the width of the map, in voxels of the finest level that is drawn. */
const HALF_VOXELS = 256;
const MOVED = 0.15;

/** `openness`: the share of the sky that is seen, from 0 to 1. */
export const OPENNESS = /* glsl */ `
#ifdef FINE
uniform sampler2D heights;
uniform mat4 heightsMatrix;
uniform float heightsTexel;

/** The average of four squares around, which hides that they are squares. */
float around(vec2 at, float level) {
  vec2 step = exp2(level) * 0.5 / vec2(${SIZE}.0);
  return 0.25 * (textureLod(heights, at + step, level).r + textureLod(heights, at - step, level).r
    + textureLod(heights, at + vec2(step.x, -step.y), level).r + textureLod(heights, at + vec2(-step.x, step.y), level).r);
}

/** How far under the ground the viewer is, from 0 to 1. */
float buried() {
  vec3 at = (heightsMatrix * vec4(cameraPosition, 1.0)).xyz;
  return clamp((textureLod(heights, at.xy, 3.0).r - at.z) / (6.0 * max(heightsTexel, 0.1)), 0.0, 1.0);
}

float openness(vec3 place, vec3 normal, vec3 up) {
  if (heightsTexel == 0.0) return 1.0;
  vec3 at = (heightsMatrix * vec4(place + normal * heightsTexel, 1.0)).xyz;
  vec2 inside = min(at.xy, 1.0 - at.xy);
  float known = smoothstep(0.0, 0.1, min(inside.x, inside.y));
  if (known <= 0.0) return 1.0;
  float hidden = 0.0;
  hidden += 0.40 * clamp((around(at.xy, 1.0) - at.z) / (4.0 * heightsTexel), 0.0, 1.0);
  hidden += 0.35 * clamp((around(at.xy, 3.0) - at.z) / (9.0 * heightsTexel), 0.0, 1.0);
  hidden += 0.25 * clamp((around(at.xy, 4.5) - at.z) / (26.0 * heightsTexel), 0.0, 1.0);
  return 1.0 - 0.96 * hidden * known;
}
#else
float buried() {
  return 0.0;
}

float openness(vec3 place, vec3 normal, vec3 up) {
  return 1.0;
}
#endif
`;

/** The map of heights around the viewer. */
export class Openness {
  readonly uniforms: OpennessUniforms;
  private readonly camera = new OrthographicCamera();
  private readonly target = new WebGLRenderTarget(SIZE, SIZE, {
    type: HalfFloatType,
    format: RedFormat,
    minFilter: LinearMipmapLinearFilter,
    magFilter: LinearFilter,
    generateMipmaps: true,
  });
  private readonly material: ShaderMaterial;
  private readonly middle = new Vector3(Infinity, 0, 0);
  private half = 0;
  private isStale = true;

  constructor() {
    this.uniforms = {
      heights: { value: this.target.texture },
      heightsMatrix: { value: new Matrix4() },
      heightsTexel: { value: 0 },
    };
    this.material = placed(
      new ShaderMaterial({
        uniforms: { heightsMatrix: this.uniforms.heightsMatrix },
        vertexShader: `varying float height;
        uniform mat4 heightsMatrix;
        void main() {
          #include <begin_vertex>
          vec4 world = modelMatrix * vec4(transformed, 1.0);
          height = (heightsMatrix * world).z;
          gl_Position = projectionMatrix * (viewMatrix * world);
        }`,
        fragmentShader: "varying float height; void main() { gl_FragColor = vec4(height); }",
        toneMapped: false,
      }),
    );
  }

  /** Chunks or the origin have changed. */
  outdate(): void {
    this.isStale = true;
  }

  /** Keeps the map where it is in the world: `by` is where the scene's origin was. */
  move(by: Vector3): void {
    this.middle.add(by);
    this.uniforms.heightsMatrix.value.multiply(new Matrix4().makeTranslation(by.clone().negate()));
  }

  /** Draws the map if it is out of date; returns whether it was. */
  update(renderer: WebGLRenderer, { focus, voxel, draw }: Sight, up: Vector3): boolean {
    const half = HALF_VOXELS * voxel;
    if (!this.isStale && half === this.half && this.middle.distanceTo(focus) < half * MOVED) {
      return false;
    }
    this.isStale = false;
    this.half = half;
    this.middle.copy(focus);
    const camera = this.camera;
    camera.left = camera.bottom = -half;
    camera.right = camera.top = half;
    camera.near = 0;
    camera.far = 4 * half;
    camera.updateProjectionMatrix();
    camera.up.set(up.y, up.z, up.x);
    camera.position.copy(focus).addScaledVector(up, 2 * half);
    camera.lookAt(focus);
    camera.updateMatrixWorld(true);
    this.uniforms.heightsMatrix.value
      .set(0.5, 0, 0, 0.5, 0, 0.5, 0, 0.5, 0, 0, -2 * half, 0, 0, 0, 0, 1)
      .multiply(camera.projectionMatrix)
      .multiply(camera.matrixWorldInverse);
    this.uniforms.heightsTexel.value = (2 * half) / SIZE;
    const before = renderer.getRenderTarget();
    const [colour, alpha] = [renderer.getClearColor(new Color()), renderer.getClearAlpha()];
    renderer.setRenderTarget(this.target);
    renderer.setClearColor(new Color(-2 * half, 0, 0), 1); // where there is nothing, nothing hides the sky
    renderer.clear();
    draw(camera, this.material);
    renderer.setRenderTarget(before);
    renderer.setClearColor(colour, alpha);
    return true;
  }

  dispose(): void {
    this.target.dispose();
    this.material.dispose();
  }
}
