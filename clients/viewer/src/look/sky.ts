/**
 * The sky: worked out for few directions in each frame and kept in a small texture, which the dome and the haze before
 * the ground both read. So the ground fades into exactly the sky that is behind it.
 */

import {
  BackSide,
  ClampToEdgeWrapping,
  HalfFloatType,
  LinearFilter,
  Mesh,
  OrthographicCamera,
  PlaneGeometry,
  Scene,
  ShaderMaterial,
  SphereGeometry,
  Vector3,
  WebGLRenderTarget,
  type PerspectiveCamera,
  type Texture,
  type WebGLRenderer,
} from "three";

import { AIR, type AirUniforms } from "./air.js";
import { CLOUDS } from "./clouds.js";
import { SEA } from "./sea.js";

const [AZIMUTHS, ELEVATIONS] = [64, 128];
/** Periods of the clouds' texture a second. */
const DRIFT = 0.0006;

/** What a shader needs to read the sky. */
export interface SkyUniforms {
  [name: string]: { value: unknown };
  sky: { value: Texture };
  skyUp: { value: Vector3 };
  /** Level, towards the sun. */
  skySun: { value: Vector3 };
  /** The horizon's angle below the level. */
  skyDip: { value: number };
}

/** `skyAt`: the light from a direction, and how much of what is behind the air comes through. */
export const SKY = /* glsl */ `
uniform sampler2D sky;
uniform vec3 skyUp;
uniform vec3 skySun;
uniform float skyDip;

vec4 skyAt(vec3 direction) {
  float above = asin(clamp(dot(direction, skyUp), -1.0, 1.0)) + skyDip;
  float range = above > 0.0 ? 1.5707963 + skyDip : 1.5707963 - skyDip;
  float v = 0.5 + 0.5 * sign(above) * sqrt(abs(above) / range);
  vec3 level = direction - skyUp * dot(direction, skyUp);
  float u = acos(clamp(dot(level, skySun) / max(length(level), 1e-5), -1.0, 1.0)) * 0.31830989;
  return texture2D(sky, vec2(u, v));
}
`;

/** `hazed`: what is left of light from so many metres away, and what the air before it adds. Needs AIR and SKY. */
export const HAZE = /* glsl */ `
uniform float visibility;

vec3 hazed(vec3 light, vec3 direction, float far) {
#ifdef PLANET
  vec3 added;
  vec3 through;
  vec3 from = cameraPosition - airCentre;
  float outside = smoothstep(0.1, 0.8, length(from) / airShape.x - 1.0);
  // seen from space, the ground's rim fades into that of the air
  float grazing = 1.0 - abs(dot(direction, normalize(from + direction * far)));
  float clear = 0.45 + outside * (0.15 - 0.6 * pow(grazing, 4.0));
  scatter(from, direction, far, AIR_STEPS, added, through);
  return light * mix(through, vec3(1.0), clear) + added * (1.0 - clear);
#else
  float haze = far / visibility;
  float through = exp(-0.5 * haze - 3.4 * haze * haze * haze);
  vec3 ahead = direction;
  ahead.y = max(ahead.y, 0.004);
  return mix(skyAt(normalize(ahead)).rgb, light, through);
#endif
}
`;

/** What is in it beside air, or stands before it. */
export interface SkyParts {
  /** Of the sea, the clouds and the ground's noise. */
  readonly uniforms: Readonly<Record<string, { value: unknown }>>;
  readonly defines: Readonly<Record<string, number | string>>;
}

/** Draws it: before each frame `update`; the dome is in the scene. */
export class Sky {
  readonly uniforms: SkyUniforms;
  private readonly target = new WebGLRenderTarget(AZIMUTHS, ELEVATIONS, {
    type: HalfFloatType,
    minFilter: LinearFilter,
    magFilter: LinearFilter,
    wrapS: ClampToEdgeWrapping,
    wrapT: ClampToEdgeWrapping,
    depthBuffer: false,
  });
  private readonly dome: Mesh<SphereGeometry, ShaderMaterial>;
  private readonly quad: Mesh<PlaneGeometry, ShaderMaterial>;
  private readonly quadScene = new Scene();
  private readonly quadCamera = new OrthographicCamera(-1, 1, 1, -1, 0, 1);
  private readonly eye = { value: new Vector3() };
  /** How far clouds have gone, in periods of their texture. */
  private readonly drift = { value: 0 };

  constructor(
    private readonly scene: Scene,
    private readonly air: AirUniforms,
    steps: number,
    parts: SkyParts,
  ) {
    this.uniforms = {
      sky: { value: this.target.texture },
      skyUp: { value: new Vector3(0, 1, 0) },
      skySun: { value: new Vector3(1, 0, 0) },
      skyDip: { value: 0 },
    };
    this.quad = new Mesh(
      new PlaneGeometry(2, 2),
      new ShaderMaterial({
        uniforms: { ...air, ...this.uniforms, eye: this.eye },
        vertexShader: FLAT_VERTEX,
        fragmentShader: `#define STEPS ${steps}\n${TABLE_FRAGMENT}`,
        depthTest: false,
        depthWrite: false,
        toneMapped: false,
      }),
    );
    this.quad.frustumCulled = false;
    this.quadScene.add(this.quad);
    this.dome = new Mesh(
      new SphereGeometry(1, 48, 32),
      new ShaderMaterial({
        uniforms: { ...air, ...this.uniforms, ...parts.uniforms, drift: this.drift },
        vertexShader: DOME_VERTEX,
        fragmentShader: DOME_FRAGMENT,
        defines: { ...parts.defines },
        dithering: true,
        side: BackSide,
        depthWrite: false,
      }),
    );
    this.dome.renderOrder = 1000; // where no ground is
    this.dome.frustumCulled = false;
    this.dome.raycast = () => {};
    scene.add(this.dome);
  }

  set visible(isVisible: boolean) {
    this.dome.visible = isVisible;
  }

  get visible(): boolean {
    return this.dome.visible;
  }

  /** Works the sky out anew, for a viewer. */
  update(renderer: WebGLRenderer, camera: PerspectiveCamera, up: Vector3, seconds: number): void {
    this.drift.value = (this.drift.value + Math.min(seconds, 1) * DRIFT) % 1;
    const [ground] = this.air.airShape.value;
    const eye = this.eye.value.copy(camera.position).sub(this.air.airCentre.value);
    const height = Math.max(eye.length(), ground * (1 + 1e-6));
    const sun = this.air.sunDirection.value;
    this.uniforms.skyUp.value.copy(up);
    this.uniforms.skyDip.value = Math.acos(Math.min(1, ground / height));
    const level = this.uniforms.skySun.value.copy(sun).addScaledVector(up, -sun.dot(up));
    if (level.length() < 1e-4) {
      level.set(up.y, up.z, up.x).addScaledVector(up, -level.dot(up));
    }
    level.normalize();
    this.dome.position.copy(camera.position);
    this.dome.scale.setScalar(camera.near * 10);
    const before = renderer.getRenderTarget();
    renderer.setRenderTarget(this.target);
    renderer.render(this.quadScene, this.quadCamera);
    renderer.setRenderTarget(before);
  }

  dispose(): void {
    this.scene.remove(this.dome);
    for (const mesh of [this.dome, this.quad]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    this.target.dispose();
  }
}

const FLAT_VERTEX = /* glsl */ `
varying vec2 place;
void main() {
  place = uv;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}
`;

const TABLE_FRAGMENT = /* glsl */ `
varying vec2 place;
uniform vec3 eye;
${AIR}
uniform vec3 skyUp;
uniform vec3 skySun;
uniform float skyDip;
void main() {
  float v = place.y * 2.0 - 1.0;
  float above = sign(v) * v * v * (v > 0.0 ? 1.5707963 + skyDip : 1.5707963 - skyDip) - skyDip;
  float azimuth = place.x * 3.14159265;
  vec3 side = cross(skyUp, skySun);
  vec3 direction = skyUp * sin(above) + cos(above) * (skySun * cos(azimuth) + side * sin(azimuth));
  vec3 light;
  vec3 through;
  scatter(eye, direction, 1e12, STEPS, light, through);
  gl_FragColor = vec4(min(light, 500.0), dot(through, vec3(1.0 / 3.0)));
}
`;

const DOME_VERTEX = /* glsl */ `
#include <common>
varying vec3 ahead;
void main() {
  ahead = position;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_Position.z = gl_Position.w;
}
`;

const DOME_FRAGMENT = /* glsl */ `
#include <common>
#include <dithering_pars_fragment>
varying vec3 ahead;
uniform vec3 anchorLeft;
uniform sampler2D soilNoise;
${AIR}
${SKY}
${HAZE}
${CLOUDS}
${SEA}
/** One star at most in each cell of a cube's faces, few of them bright. */
float stars(vec3 direction) {
  vec3 size = abs(direction);
  float most = max(size.x, max(size.y, size.z));
  vec3 cell = direction / most * 70.0;
  vec3 corner = floor(cell + 0.5);
  vec3 random = fract(sin(vec3(
    dot(corner, vec3(12.9898, 78.233, 37.719)),
    dot(corner, vec3(39.346, 11.135, 83.155)),
    dot(corner, vec3(73.156, 52.235, 9.151)))) * 43758.5453);
  float away = length(normalize(corner + (random - 0.5) * 0.7) - normalize(direction)) * 70.0;
  float bright = random.y > 0.86 ? 0.03 + 0.9 * pow(random.x, 10.0) : 0.0;
  return bright * (1.0 - smoothstep(0.02, 0.12, away));
}
#ifdef FLAT
uniform float drift;
float cloud(vec2 at) {
  float sum = texture2D(soilNoise, at * 0.11 + drift).a * 0.62;
  sum += texture2D(soilNoise, mat2(0.6, 0.8, -0.8, 0.6) * at * 0.31 + vec2(2.0, 1.0) * drift).r * 0.26;
  sum += texture2D(soilNoise, mat2(-0.28, 0.96, -0.96, -0.28) * at * 0.93 + drift).r * 0.12;
  return sum;
}

/** A layer of clouds high above; the further away the more of the air is before them. */
vec3 clouded(vec3 light, vec3 direction) {
  float above = dot(direction, skyUp);
  if (above < 0.01) return light;
  vec2 at = direction.xz / (above + 0.06);
  float thick = smoothstep(0.52, 0.74, cloud(at));
  vec2 towards = sunDirection.xz / max(length(sunDirection.xz), 1e-4);
  float shade = cloud(at + towards * 0.16) - cloud(at - towards * 0.05);
  float mu = max(dot(direction, sunDirection), 0.0);
  vec3 sun = sunLight * (0.13 + 0.20 * pow(mu, 6.0));
  vec3 lit = sun * clamp(0.75 - 2.2 * shade, 0.3, 1.15) + vec3(0.30, 0.42, 0.58) * (1.0 - 0.35 * thick);
  float share = thick * 0.85 * smoothstep(0.015, 0.22, above);
  return mix(light, lit, share);
}
#endif
void main() {
  vec3 direction = normalize(ahead);
#ifdef FLAT
  vec4 air = skyAt(normalize(direction + skyUp * max(0.004 - dot(direction, skyUp), 0.0)));
#else
  vec4 air = skyAt(direction);
#endif
  vec3 light = air.rgb;
  float dark = clamp(1.0 - dot(light, vec3(3.0)), 0.0, 1.0);
  light += stars(direction) * air.a * air.a * dark * dark;
  float apart = acos(clamp(dot(direction, sunDirection), -1.0, 1.0));
  float above = asin(clamp(dot(direction, skyUp), -1.0, 1.0)) + skyDip;
  float disc = 1.0 - smoothstep(0.011, 0.0135, apart);
  float glow = 0.012 / (0.002 + apart * apart * 14.0) * exp(-apart * 5.0);
  light += (disc * 3.0 + glow * 0.02) * sunLight * air.a * smoothstep(-0.004, 0.004, above);
#ifdef FLAT
  light = clouded(light, direction);
#endif
  vec3 eye = cameraPosition - airCentre;
  float far = 1e7;
#ifdef CLOUDS
  light = overcast(light, eye, direction, far);
#endif
#ifdef SEA
  float along = surfaceAlong(direction, skyUp);
  if (sea.y < 0.0) {
    light = drowned(light, direction, skyUp, far, 100.0, 1.0);
  } else if (along > 0.0) {
    light = drowned(vec3(0.0), direction, skyUp, far, 100.0, 1.0);
#ifdef CLOUDS
    light = overcast(light, eye, direction, far);
#endif
    light = hazed(light, direction, far);
  }
#endif
  gl_FragColor = vec4(light, 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
  #include <dithering_fragment>
}
`;
