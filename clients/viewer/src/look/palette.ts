/** Colours: of the ground, by what a recipe's name says of it, and of levels of detail. */

/** Linear RGB. */
export type Colour = readonly [number, number, number];

/** What the ground of a world looks like. Heights are in voxels, over y = 0 or the radius. */
export interface Ground {
  readonly rock: Colour;
  /** Rock changes to it in layers. */
  readonly rockLayer: Colour;
  /** Where it is gently sloped. */
  readonly grass: Colour;
  readonly grassDry: Colour;
  /** Where there is no grass for hundreds of metres. */
  readonly sand: Colour;
  /** Between grass and rock. */
  readonly soil: Colour;
  /** Where it is low. */
  readonly low: Colour;
  readonly snow: Colour;
  readonly lowBelow: number;
  /** Above it there is snow. */
  readonly snowAbove: number;
  /** The slope at which grass becomes rock: cosine of the angle to the horizontal. */
  readonly grassSlope: number;
  /** How much the layers in rock show. */
  readonly layers: number;
  /** How rough a detail looks: 1 is rock as it grows, 0 is smooth. */
  readonly roughness: number;
  /** Whether its air is as thin as that of a moon. */
  readonly airless: boolean;
  /** Whether it is built: streets and windows. */
  readonly isCity: boolean;
  /** Whether it is the inside of a ring around the y axis: what is level there looks at the axis. */
  readonly isRing: boolean;
  /** How far one sees through its air at least, where what is drawn ends because there is no more. Voxels. */
  readonly clear: number;
  /** How high its sea stands; null if it has none. */
  readonly sea: number | null;
  /** Of a planet, how high its clouds are over the radius, in radii. */
  readonly clouds: number | null;
  /** Of a planet: where its air begins, and over which height it thins out to a e-th, in radii. */
  readonly air: readonly [number, number];
  /** Whether a planet is large enough for climates. */
  readonly hasClimate: boolean;
}

const NEVER = 1e9;

const MEADOWS: Ground = {
  rock: srgb(0x7f7b74),
  rockLayer: srgb(0x57534d),
  grass: srgb(0x3a5226),
  grassDry: srgb(0x6c6a40),
  sand: srgb(0x857655),
  soil: srgb(0x5a4d3c),
  low: srgb(0x6f6450),
  snow: srgb(0xd3d9e2),
  lowBelow: -14,
  snowAbove: 95,
  grassSlope: 0.74,
  layers: 0.5,
  roughness: 1,
  airless: false,
  isCity: false,
  isRing: false,
  clear: 0,
  sea: null,
  clouds: null,
  air: [0.97, 0.045],
  hasClimate: false,
};

const DESERT: Ground = {
  ...MEADOWS,
  rock: srgb(0xb9744a),
  rockLayer: srgb(0xd7a173),
  grass: srgb(0xc9955f),
  grassDry: srgb(0xdcb382),
  sand: srgb(0xd2a573),
  soil: srgb(0xc08a58),
  low: srgb(0xc9955f),
  lowBelow: -NEVER,
  snowAbove: NEVER,
  grassSlope: 0.8,
  layers: 1,
};

const MOON: Ground = {
  ...MEADOWS,
  rock: srgb(0x8a8783),
  rockLayer: srgb(0x75726f),
  grass: srgb(0x9d9a95),
  grassDry: srgb(0xb0ada8),
  sand: srgb(0x6f6d6a),
  soil: srgb(0x86837f),
  low: srgb(0x86837f),
  lowBelow: -NEVER,
  snowAbove: NEVER,
  grassSlope: 0.6,
  layers: 0.15,
  airless: true,
};

const CITY: Ground = {
  ...MEADOWS,
  rock: srgb(0xb8b2a8),
  rockLayer: srgb(0xa59e93),
  grass: srgb(0x9a958d),
  grassDry: srgb(0xaaa49a),
  sand: srgb(0x9a958d),
  soil: srgb(0xa59e93),
  low: srgb(0x4a4b4e),
  lowBelow: 1.5,
  snowAbove: NEVER,
  grassSlope: 0.9,
  layers: 0,
  roughness: 0.16,
  isCity: true,
};

const GROUNDS: Readonly<Record<string, Ground>> = {
  planet: { ...MEADOWS, low: srgb(0xa8986c), lowBelow: -5.5, snowAbove: 15, sea: -6.5, clouds: 0.13 },
  continents: {
    ...MEADOWS,
    low: srgb(0xbfae82),
    lowBelow: 4,
    snow: srgb(0xbcc4cf),
    sea: 0,
    clouds: 0.06,
    air: [0.99, 0.028],
    hasClimate: true,
  },
  islands: { ...MEADOWS, low: srgb(0xcdb988), lowBelow: 3, snowAbove: 78, sea: 0 },
  canyon: DESERT,
  arches: DESERT,
  moon: MOON,
  ring: { ...MEADOWS, lowBelow: -NEVER, snowAbove: NEVER, grassSlope: 0.7, isRing: true, clear: 6000 },
  city: CITY,
};

/** The ground of a recipe; meadows and rock for one that it does not know. */
export function groundOf(name: string): Ground {
  return GROUNDS[name] ?? MEADOWS;
}

/** The colour of each level of detail, sRGB as 0xRRGGBB, the finest first; from the last on they start again. */
export const LEVELS: readonly number[] = [
  0x3b82f6, 0x22c55e, 0xfacc15, 0xf97316, 0xdc2626, 0xd946ef, 0x8b5cf6, 0x14b8a6, 0xa3e635, 0xf472b6,
];

/** 0xRRGGBB of sRGB to linear. */
export function srgb(hex: number): Colour {
  const [red, green, blue] = [hex >> 16, (hex >> 8) & 255, hex & 255].map((byte) => {
    const value = byte / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
  return [red!, green!, blue!];
}
