// The page's state, as one object that its address also holds; and the mathematics of rotations.

export const SEQUENCES = {
  shared: ["sobol", "lattice", "r2", "stratified", "independent"],
  "median-cut": [],
  harmonics: [],
  light: ["sobol", "lattice", "independent"],
  bsdf: ["sobol", "lattice", "independent"],
  mis: ["sobol", "lattice", "independent"],
  product: ["sobol", "lattice", "independent"],
};
export const SEQUENCE_NAMES = {
  sobol: "Sobol",
  lattice: "Lattice",
  r2: "R2 lattice",
  stratified: "Stratified",
  independent: "Independent",
};
// Per method: the smallest and largest count, the initial one, and the label of what is counted.
export const COUNTS = {
  shared: { low: 1, most: 65536, first: 256, label: "Samples" },
  "median-cut": { low: 1, most: 4096, first: 64, label: "Lights" },
  harmonics: { low: 0, most: 24, first: 2, label: "Order" },
  light: { low: 1, most: 256, first: 16, label: "Samples per pixel" },
  bsdf: { low: 1, most: 256, first: 16, label: "Samples per pixel" },
  mis: { low: 1, most: 256, first: 16, label: "Samples per pixel" },
  product: { low: 1, most: 256, first: 16, label: "Samples per pixel" },
};
export const LIMITS = {
  seed: [0, 2 ** 53], yaw: [-1e6, 1e6], pitch: [-1e6, 1e6], roll: [-1e6, 1e6], ev: [-40, 40], gamma: [0.1, 10],
  difference: [0.01, 1000], albedo: [0, 100], resolution: [16, 1023], wipe: [0, 100], eta: [1, 4], map: [0, 999],
};
export const INITIAL = {
  tab: "light", map: 0, method: "shared", sequence: "sobol", count: 256, seed: 159, yaw: 0, pitch: 0, roll: 0,
  ev: 0, gamma: 2.2, tone: "clip", difference: 10, albedo: 1, resolution: 511, marks: true, wipe: 100, eta: 1.4,
};

/** The state that an address holds, with the initial value for anything invalid. */
export function readAddress(hash) {
  const state = { ...INITIAL };
  for (const [name, text] of new URLSearchParams(hash.replace(/^#/, ""))) {
    if (!(name in INITIAL)) continue;
    if (typeof INITIAL[name] === "number") {
      const value = Number(text);
      const [low, high] = LIMITS[name] ?? [0, 65536];
      if (text !== "" && value >= low && value <= high) state[name] = value;
    } else if (typeof INITIAL[name] === "boolean") state[name] = text === "true";
    else state[name] = text;
  }
  for (const name of ["map", "seed", "count", "resolution"]) state[name] = Math.round(state[name]);
  if (!["light", "fresnel", "check"].includes(state.tab)) state.tab = "light";
  if (!(state.method in SEQUENCES)) state.method = INITIAL.method;
  if (!["clip", "soft"].includes(state.tone)) state.tone = "clip";
  return fitting(state);
}

/** The address of a state; it lists only what differs from the initial state. */
export function toAddress(state) {
  const words = new URLSearchParams();
  for (const name of Object.keys(INITIAL)) if (state[name] !== INITIAL[name]) words.set(name, String(state[name]));
  return words.size ? `#${words}` : "#";
}

/** Adjusts a state's sequence and count to its method. */
export function fitting(state) {
  const sequences = SEQUENCES[state.method];
  if (sequences.length && !sequences.includes(state.sequence)) state.sequence = sequences[0];
  const { low, most } = COUNTS[state.method];
  state.count = Math.min(most, Math.max(low, state.count));
  return state;
}

/** Slider positions for counts: powers of two, or the order itself. */
export const toSlider = (method, count) => (method === "harmonics" ? count : Math.log2(count));
export const fromSlider = (method, value) => (method === "harmonics" ? value : Math.round(2 ** value));

const radians = (degrees) => (degrees * Math.PI) / 180;

/** The matrix R = R_y(yaw) R_x(pitch) R_z(roll), by rows: light from d comes from R d after the turn. */
export function rotation({ yaw, pitch, roll }) {
  return times(times(about("y", radians(yaw)), about("x", radians(pitch))), about("z", radians(roll)));
}

export function about(axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  if (axis === "x") return [[1, 0, 0], [0, c, -s], [0, s, c]];
  if (axis === "y") return [[c, 0, s], [0, 1, 0], [-s, 0, c]];
  return [[c, -s, 0], [s, c, 0], [0, 0, 1]];
}

/** The rotation by an angle, in radians, about a unit vector. */
export function aboutVector([x, y, z], angle) {
  const c = Math.cos(angle), s = Math.sin(angle), t = 1 - c;
  return [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
}

export const times = (a, b) => a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));

/** Yaw, pitch and roll of a rotation, in degrees, rounded to keep the address short. */
export function angles(R) {
  const degrees = (x) => Math.round((x * 180e4) / Math.PI) / 1e4 + 0;
  const sine = Math.max(-1, Math.min(1, -R[1][2]));
  if (Math.abs(sine) > 0.9999999) {
    return { yaw: degrees(Math.atan2(-R[2][0], R[0][0])), pitch: sine > 0 ? 90 : -90, roll: 0 };
  }
  return {
    yaw: degrees(Math.atan2(R[0][2], R[2][2])),
    pitch: degrees(Math.asin(sine)),
    roll: degrees(Math.atan2(R[1][0], R[1][1])),
  };
}
