/**
 * The sun's shadows: two square depth maps around the viewer, one within the other, seen along the sunlight. They are
 * drawn anew when chunks have changed or the viewer has moved on, not in each frame, and their texels stay where they are
 * in the world, so that edges of shadows do not crawl.
 */

import {
  DepthTexture,
  FrontSide,
  LessEqualCompare,
  LinearFilter,
  Matrix4,
  OrthographicCamera,
  ShaderMaterial,
  UnsignedIntType,
  Vector3,
  WebGLRenderTarget,
  type Material,
  type Texture,
  type WebGLRenderer,
} from "three";

import { placed } from "chunkserver-client/three";

/** What a shader needs to know where the sun shines. */
export interface ShadowUniforms {
  [name: string]: { value: unknown };
  shadowNear: { value: Texture | null };
  shadowFar: { value: Texture | null };
  shadowNearMatrix: { value: Matrix4 };
  shadowFarMatrix: { value: Matrix4 };
  /** Width of a texel, near and far, in metres; 0 where there is none. */
  shadowTexel: { value: [number, number] };
}

/** Half the width of the near map, in voxels of the finest level that is drawn; of the far map, times that. */
const NEAR_VOXELS = 72;
const FAR_TIMES = 6;
/** A map is drawn anew when the viewer has moved by this share of its half width. */
const MOVED = 0.12;

/** What maps around the viewer are drawn of. */
export interface Sight {
  /** The ground nearest to the viewer. */
  readonly focus: Vector3;
  /** Width of a voxel of the finest level that is drawn, metres. */
  readonly voxel: number;
  /** Draws all chunks, and nothing else, with one material. */
  draw(camera: OrthographicCamera, material: Material): void;
}

/** `sunlight`: the share of the sun that is seen from a point. */
export const SHADOW = /* glsl */ `
#ifdef FINE
precision highp sampler2DShadow;
uniform sampler2DShadow shadowNear;
uniform sampler2DShadow shadowFar;
uniform mat4 shadowNearMatrix;
uniform mat4 shadowFarMatrix;
uniform vec2 shadowTexel;

/** Nine bilinear comparisons, with the weights of a tent. */
float softened(sampler2DShadow map, vec3 at) {
  vec2 texel = 1.25 / vec2(textureSize(map, 0));
  float sum = 0.0;
  for (int row = -1; row <= 1; row++) {
    for (int column = -1; column <= 1; column++) {
      float weight = (row == 0 ? 2.0 : 1.0) * (column == 0 ? 2.0 : 1.0);
      sum += weight * texture(map, vec3(at.xy + vec2(column, row) * texel, at.z));
    }
  }
  return sum / 16.0;
}

float edge(vec3 at) {
  vec3 inside = min(at, 1.0 - at);
  return smoothstep(0.0, 0.06, min(inside.x, inside.y)) * step(0.0, inside.z);
}

float sunlight(vec3 place, vec3 normal, float far) {
  if (shadowTexel.x == 0.0) return 1.0;
  float lean = 1.0 - max(dot(normal, sunDirection), 0.0);
  vec3 near = (shadowNearMatrix * vec4(place + normal * shadowTexel.x * (1.0 + 2.0 * lean), 1.0)).xyz;
  float nearest = edge(near);
  float found = 1.0;
  if (nearest < 1.0) {
    vec3 wide = (shadowFarMatrix * vec4(place + normal * shadowTexel.y * (1.0 + 2.0 * lean), 1.0)).xyz;
    float within = edge(wide);
    if (within > 0.0) found = mix(1.0, softened(shadowFar, wide), within);
  }
  if (nearest > 0.0) found = mix(found, softened(shadowNear, near), nearest);
  return found;
}
#else
float sunlight(vec3 place, vec3 normal, float far) {
  return 1.0;
}
#endif
`;

/** One map, and where it is. */
class ShadowMap {
  readonly camera = new OrthographicCamera();
  readonly target: WebGLRenderTarget;
  readonly matrix = new Matrix4();
  isStale = true;
  private readonly middle = new Vector3(Infinity, 0, 0);
  private half = 0;

  constructor(private readonly size: number) {
    const depthTexture = new DepthTexture(size, size, UnsignedIntType);
    depthTexture.compareFunction = LessEqualCompare;
    depthTexture.magFilter = depthTexture.minFilter = LinearFilter;
    this.target = new WebGLRenderTarget(size, size, { depthTexture });
  }

  get texel(): number {
    return (2 * this.half) / this.size;
  }

  isStaleFor(middle: Vector3, half: number): boolean {
    return this.isStale || half !== this.half || !(this.middle.distanceTo(middle) < half * MOVED);
  }

  /** The scene's origin is elsewhere by now: `by` is where it was. */
  move(by: Vector3): void {
    this.middle.add(by);
    this.matrix.multiply(new Matrix4().makeTranslation(by.clone().negate()));
  }

  /** origin: a point of the scene that stays where it is in the world. depth: how far shadows are cast from. */
  place(middle: Vector3, half: number, depth: number, sun: Vector3, origin: Vector3): void {
    this.isStale = false;
    this.half = half;
    this.middle.copy(middle);
    const camera = this.camera;
    camera.left = camera.bottom = -half;
    camera.right = camera.top = half;
    camera.near = 0;
    camera.far = 2 * depth;
    camera.updateProjectionMatrix();
    const turned = new Matrix4().lookAt(sun, new Vector3(), Math.abs(sun.y) > 0.9 ? AXIS_X : AXIS_Y);
    const back = turned.clone().transpose();
    // whole texels from the origin, across the light
    const local = middle.clone().sub(origin).applyMatrix4(back);
    local.x = Math.round(local.x / this.texel) * this.texel;
    local.y = Math.round(local.y / this.texel) * this.texel;
    local.z += depth;
    camera.quaternion.setFromRotationMatrix(turned);
    camera.position.copy(local.applyMatrix4(turned).add(origin));
    camera.updateMatrixWorld(true);
    this.matrix.copy(TO_UNIT).multiply(camera.projectionMatrix).multiply(camera.matrixWorldInverse);
  }
}

const AXIS_X = new Vector3(1, 0, 0);
const AXIS_Y = new Vector3(0, 1, 0);
const TO_UNIT = new Matrix4().set(0.5, 0, 0, 0.5, 0, 0.5, 0, 0.5, 0, 0, 0.5, 0.5, 0, 0, 0, 1);

/** Both maps. */
export class Shadows {
  readonly uniforms: ShadowUniforms;
  private readonly near: ShadowMap;
  private readonly far: ShadowMap;
  private readonly material = placed(
    new ShaderMaterial({
      vertexShader: `void main() {
        #include <begin_vertex>
        gl_Position = projectionMatrix * (viewMatrix * (modelMatrix * vec4(transformed, 1.0)));
      }`,
      fragmentShader: "void main() { gl_FragColor = vec4(1.0); }",
      side: FrontSide,
      colorWrite: false,
    }),
  );

  constructor(renderer: WebGLRenderer, size: number) {
    this.near = new ShadowMap(size);
    this.far = new ShadowMap(size);
    // a shader that compares may not be given a texture that is none
    [this.near, this.far].forEach(({ target }) => renderer.initRenderTarget(target));
    this.uniforms = {
      shadowNear: { value: this.near.target.depthTexture },
      shadowFar: { value: this.far.target.depthTexture },
      shadowNearMatrix: { value: this.near.matrix },
      shadowFarMatrix: { value: this.far.matrix },
      shadowTexel: { value: [0, 0] },
    };
  }

  /** Chunks, the sun or the origin have changed. */
  outdate(): void {
    this.near.isStale = this.far.isStale = true;
  }

  /** Keeps shadows where they are in the world: `by` is where the scene's origin was. */
  move(by: Vector3): void {
    this.near.move(by);
    this.far.move(by);
  }

  /**
   * Draws one map if it is out of date.
   *
   * @param sight what is seen from where
   * @param sun the direction to it
   * @param origin a point of the scene that stays where it is in the world
   * @returns whether anything was drawn
   */
  update(which: "near" | "far", renderer: WebGLRenderer, sight: Sight, sun: Vector3, origin: Vector3): boolean {
    const half = NEAR_VOXELS * sight.voxel;
    const [map, width] = which === "near" ? [this.near, half] : [this.far, half * FAR_TIMES];
    if (!map.isStaleFor(sight.focus, width)) {
      return false;
    }
    map.place(sight.focus, width, half * FAR_TIMES * 3, sun, origin);
    const before = renderer.getRenderTarget();
    renderer.setRenderTarget(map.target);
    renderer.clear(false, true, false);
    sight.draw(map.camera, this.material);
    renderer.setRenderTarget(before);
    this.uniforms.shadowTexel.value = [this.near.texel, this.far.texel];
    return true;
  }

  dispose(): void {
    for (const { target } of [this.near, this.far]) {
      target.depthTexture?.dispose();
      target.dispose();
    }
    this.material.dispose();
  }
}
