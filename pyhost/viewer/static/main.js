// The page: controls and dragging change the state; the server is asked for its picture, one at a time.

import { MapView, SphereView } from "./draw.js";
import { ends, logLog, paretoFront, percent, short, thousands } from "./plots.js";
import {
  about, aboutVector, angles, COUNTS, fitting, fromSlider, INITIAL, LIMITS, readAddress, rotation, SEQUENCE_NAMES,
  SEQUENCES, times, toAddress, toSlider,
} from "./state.js";
import { CheckPage, fill, fresnelKey, MATERIALS, showFresnel } from "./tabs.js";

const $ = (id) => document.getElementById(id);
const state = readAddress(location.hash);
const TABS = ["light", "fresnel", "check"];
const FORMATS = { csv: "CSV", json: "JSON", pbrt: "PBRT", mitsuba: "Mitsuba", gltf: "glTF", usda: "USD", blender: "Blender" };
const TYPES = { float16: Uint16Array, float32: Float32Array, int32: Int32Array, uint8: Uint8Array };
const MOST_POINTS = 500;
const TELLING = 120; // milliseconds between updates of the numbers while the user drags
const PATIENCE = 120; // milliseconds for which the map waits for its sphere

let mapView = null, sphereView = null;
const maps = new Map(); // headers of answers, by number
let hasPictures = false; // true without WebGL: the server draws
let shownTurn = rotation(state); // the rotation of the map and sphere on the screen
let numbers = { brightest: 0 };
let points = [], followed = null, now = null;
// For measurements: the times of the latest frames, in milliseconds.
const frames = [];
// For tests: what is shown, and whether the page has finished updating.
globalThis.lightdomeView = {
  state, frames, turn, front: () => paretoFront(points),
  get points() { return points; },
  get numbers() { return numbers; },
  get exposures() { return maps.get(state.map)?.exposures; },
  get images() { return { image: sphereView.image.array, reference: sphereView.reference.array }; },
  get isSettled() {
    return !inFlight && !isWaiting && !isMoving && !isDrawing && numbers.is_exact === true && maps.has(state.map);
  },
};

// ---- talking to the server ----

let socket = null, isOpen = false, inFlight = null, isWaiting = false, isMoving = false, movedAt = 0, tries = 0;

/** Unpacks an answer; the arrays are views of its bytes. */
export function decode(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, { shape, type, offset, bytes, scale }] of Object.entries(header.arrays)) {
    const Type = TYPES[type];
    arrays[name] = { shape, type, scale, data: new Type(buffer, 4 + length + offset, bytes / Type.BYTES_PER_ELEMENT) };
  }
  return { header, arrays };
}

function connect() {
  socket = new WebSocket(new URL("talk", location.href.replace(/^http/, "ws")));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    isOpen = true;
    tries = 0;
    inFlight = null;
    banner("");
    say({ do: "map", map: state.map });
    say({ do: "fresnel", eta: state.eta });
    changed(false);
  };
  socket.onmessage = ({ data }) => hear(decode(data));
  socket.onclose = () => {
    isOpen = false;
    banner("Not connected. The command may have ended. Trying to reconnect …");
    setTimeout(connect, Math.min(10000, 500 * 2 ** tries++));
  };
}

const say = (wish) => isOpen && socket.send(JSON.stringify(wish));

function wish() {
  const { map, method, sequence, count, seed, yaw, pitch, roll, albedo, resolution } = state;
  const asked = { map, method, sequence, count, seed, yaw, pitch, roll, albedo, resolution, moving: isMoving };
  if (hasPictures) Object.assign(asked, { pictures: true, exposure: stops(), gamma: state.gamma, difference: state.difference });
  return asked;
}

/** The state changed: ask for its picture, now or as soon as the pending answer arrives. */
function changed(moving, since = performance.now()) {
  isMoving = moving;
  if (!isWaiting) movedAt = since;
  isWaiting = true;
  ask();
  // The map waits for its sphere, but not for long.
  if (performance.now() - Math.max(drawnAt, inFlight?.asked ?? 0) > PATIENCE) {
    shownTurn = rotation(state);
    redraw();
  }
  remember();
}

function ask() {
  if (!isOpen || inFlight || !isWaiting) return;
  isWaiting = false;
  inFlight = { asked: performance.now(), moved: movedAt, setting: wish() };
  say({ do: "frame", ...inFlight.setting });
}

function hear({ header, arrays }) {
  const kind = header.kind;
  if (kind === "hello") hello(header);
  else if (kind === "map") {
    maps.set(header.map, header);
    if (header.map !== state.map) return;
    mapView?.map.put(arrays.map);
    sphereView?.six.put(arrays.six);
    $("map-name").textContent = `${header.name}, ${header.width} × ${header.height}, radiance up to ${short(header.peak)}`;
    redraw();
  } else if (kind === "frame") {
    const flight = { ...inFlight, arrived: performance.now(), bytes: 0, server: header.server_ms };
    inFlight = null;
    ask(); // the server works while this page draws
    takeFrame(header, arrays, flight);
  } else if (kind === "exact") {
    sphereView?.reference.put(arrays.reference);
    takeNumbers(header, true, now?.setting);
    redraw();
  } else if (kind === "followed") {
    followed = { method: state.method, sequence: state.sequence, ...header };
    plotFollowed();
  } else if (kind === "fresnel") showFresnel(header);
  else if (kind === "command") {
    $("command").value = header.lines.join("\n");
    $("command").rows = 3 * header.lines.length;
    $("command-note").textContent = header.note;
  } else if (kind === "saved") download(header.name, new Blob([header.text], { type: "text/plain" }));
  else if (kind === "error") {
    if (header.of === "frame") {
      inFlight = null;
      ask();
    }
    banner(header.text);
  }
}

function hello({ maps: names, device }) {
  $("map").replaceChildren(...names.map((name, n) => option(n, name)));
  $("map-choice").hidden = names.length < 2;
  if (state.map >= names.length) {
    state.map = 0;
    say({ do: "map", map: 0 });
    changed(false);
  }
  $("map").value = state.map;
  $("about").textContent = `Computed on ${device}.`;
}

function takeFrame(header, arrays, flight) {
  banner("");
  if (hasPictures) {
    for (const name of ["map", "image", "reference", "difference"]) {
      const image = $(`${name}-picture`);
      URL.revokeObjectURL(image.src);
      image.src = URL.createObjectURL(new Blob([arrays[name].data], { type: "image/png" }));
    }
  } else {
    sphereView.image.put(arrays.image);
    if (arrays.reference) sphereView.reference.put(arrays.reference);
    if (arrays.direction) {
      mapView.putMarks(arrays.direction.data, arrays.size.data);
      const of = maps.get(state.map);
      if (of) mapView.putRegions(arrays.regions.data, of.width, of.height);
      $("marks-label").textContent = arrays.regions.data.length ? "Regions and lights" : "Samples";
      $("marks").disabled = !arrays.size.data.length;
    }
  }
  now = { setting: flight.setting, flight };
  shownTurn = rotation(flight.setting);
  takeNumbers(header, header.is_exact, flight.setting);
  redraw(() => {
    flight.drawn = performance.now();
    frames.push(flight);
    if (frames.length > 1024) frames.shift();
  });
}

function takeNumbers(header, isExact, setting) {
  const { rmse } = header.numbers;
  numbers = { ...header.numbers, is_exact: isExact };
  if (isExact && rmse > 0 && setting) addPoint(setting, header.method_ms, rmse);
  mustTell = () => tellNumbers(header, isExact, setting);
}

function tellNumbers(header, isExact, setting) {
  const { rmse, largest, brightest } = header.numbers;
  $("rmse").textContent = rmse === null ? "–" : `${isExact ? "" : "≈ "}${percent(rmse)}`;
  $("largest").textContent = `${isExact ? "" : "≈ "}${short(largest)} radiance`;
  $("device-ms").textContent = `${header.device_ms.toFixed(1)} ms`;
  const flight = frames[frames.length - 1];
  if (flight) $("whole-ms").textContent = `${(flight.drawn - flight.moved).toFixed(0)} ms`;
  $("method-ms").textContent = `${header.method_ms.toFixed(1)} ms`;
  $("numbers-note").textContent = isExact ? "Compared with the exact image." : "Compared with an approximation; the exact image follows when you stop moving.";
  $("exact-state").textContent = isExact ? "" : "approximate while moving";
  $("method-name").textContent = methodName(setting ?? state);
  if (brightest === 0) $("numbers-note").textContent = "The image is black.";
}

const methodName = ({ method, sequence, count }) => {
  const name = $("method").querySelector(`[value="${method}"]`).textContent;
  if (method === "shared") return `${SEQUENCE_NAMES[sequence]}, ${count} samples`;
  if (method === "harmonics") return `Harmonics up to order ${count}`;
  if (method === "median-cut") return `Median cut, ${count} lights`;
  return `${name}, ${SEQUENCE_NAMES[sequence]}, ${count} spp`;
};

// ---- drawing ----

let isDrawing = false, drawnAt = 0, mustShow = false;
let afterDrawing = [];

function redraw(then = null) {
  if (then) afterDrawing.push(then);
  if (isDrawing) return;
  isDrawing = true;
  requestAnimationFrame(() => {
    isDrawing = false;
    drawnAt = performance.now();
    if (!hasPictures && state.tab === "light" && maps.has(state.map)) draw();
    for (const done of afterDrawing.splice(0)) done();
    const [low, high] = ends(greatest());
    if ($("scale-low").textContent !== low) [$("scale-low").textContent, $("scale-high").textContent] = [low, high];
    if (!isMoving || drawnAt - toldAt > TELLING) tell();
  });
}

let mustTell = null, toldAt = 0;

/** Bring controls and numbers up to date. While the user drags, not for every picture: nobody reads that fast. */
function tell() {
  toldAt = performance.now();
  if (mustShow) for (const show of shows) show();
  mustShow = false;
  mustTell?.();
  mustTell = null;
}

const stops = () => 2 ** state.ev;
const isDark = matchMedia("(prefers-color-scheme: dark)");
const neutral = () => (isDark.matches ? [0.16, 0.16, 0.16] : [0.93, 0.93, 0.93]);

function draw() {
  const [ofMap, ofSphere] = maps.get(state.map).exposures;
  const tone = { gamma: state.gamma, soft: state.tone === "soft" };
  mapView.draw(shownTurn, { ...tone, exposure: ofMap * stops() }, state.marks, isMoving);
  sphereView.draw({
    wipe: state.wipe / 100, difference: greatest(), albedo: now?.setting.albedo ?? state.albedo, neutral: neutral(),
    tone: { ...tone, exposure: ofSphere * stops() }, turn: numbers.is_exact ? null : shownTurn,
  });
}

/** The difference that is drawn in full colour, in radiance. */
const greatest = () => (state.difference / 100) * (numbers.brightest || 1);

// ---- numbers ----

function addPoint(setting, milliseconds, rmse) {
  const { map, yaw, pitch, roll, albedo, resolution, ...of } = setting;
  const key = JSON.stringify([map, of.method, of.sequence, of.count, of.seed, resolution]);
  points = points.filter((point) => point.key !== key);
  const label = `${methodName(setting)}${SEQUENCES[setting.method].length ? `, seed ${setting.seed}` : ""}: ${percent(rmse)} in ${milliseconds.toFixed(1)} ms`;
  points.push({ key, x: milliseconds, y: rmse, label });
  if (points.length > MOST_POINTS) points.shift();
  plotTried();
}

function plotTried() {
  if (state.tab !== "light") return;
  const last = points.length ? [points[points.length - 1]] : [];
  const series = [
    { points: paretoFront(points), kind: "front" },
    { points, kind: "marks" },
    { points: last, kind: "now" },
  ];
  logLog($("error-time"), series, { x: "method time, ms", y: "relative RMSE" });
  $("tried").textContent = `${points.length} tried; the line shows the best for each time.`;
}

function plotFollowed() {
  if (!followed || state.tab !== "light") return;
  const label = COUNTS[followed.method].label.toLowerCase();
  $("error-count-title").textContent = `Error against ${followed.method === "harmonics" ? "the order" : label}`;
  const along = followed.counts.map((x, n) => ({ x, y: followed.rmse[n], label: `${x}: ${percent(followed.rmse[n])}` }));
  logLog($("error-count"), [{ points: along, kind: "line" }], { x: label, y: "relative RMSE", formatX: thousands });
  const { slope } = followed;
  $("slope").textContent = slope === null ? "" : `Slope ${slope.toFixed(2).replace("-", "−")}: doubling the number cuts the error by ${Math.round(100 * (1 - 2 ** slope))} %. Independent samples have a slope of −0.50.`;
}

// ---- controls ----

const option = (value, text) => Object.assign(document.createElement("option"), { value, textContent: text });

/** A number field with a slider: both show the state and change it. */
function numeric(name, toPosition = (v) => v, fromPosition = (v) => v, onChange = changed) {
  const input = $(name), slider = $(`${name}-slider`);
  const set = (value, moving) => {
    const [low, high] = name === "count" ? [COUNTS[state.method].low, COUNTS[state.method].most] : LIMITS[name];
    if (!Number.isFinite(value)) return show();
    const whole = ["count", "seed", "resolution"].includes(name);
    state[name] = Math.min(high, Math.max(low, whole ? Math.round(value) : value));
    show(moving === "typing" ? input : null);
    onChange(moving === true);
  };
  const show = (but = null) => {
    if (but !== input) input.value = Number(state[name].toPrecision(7));
    if (slider) slider.value = toPosition(state[name]);
  };
  input.addEventListener("change", () => set(input.valueAsNumber, false));
  slider?.addEventListener("input", () => set(fromPosition(slider.valueAsNumber), true));
  slider?.addEventListener("change", () => set(fromPosition(slider.valueAsNumber), false));
  shows.push(show);
  return set;
}

const shows = []; // each makes one control show the state
const locally = () => { redraw(); remember(); if (hasPictures) changed(false); };

function buildControls() {
  numeric("count", (v) => toSlider(state.method, v), (v) => fromSlider(state.method, v));
  for (const name of ["seed", "yaw", "pitch", "roll", "albedo", "resolution"]) numeric(name);
  for (const name of ["ev", "gamma"]) numeric(name, undefined, undefined, () => { locally(); check.draw(); });
  numeric("difference", (v) => Math.log10(v), (v) => Number((10 ** v).toPrecision(2)), () => { locally(); check.draw(); });
  numeric("eta", undefined, undefined, () => { say({ do: "fresnel", eta: state.eta }); remember(); });
  $("method").addEventListener("change", () => choose($("method").value));
  $("sequence").addEventListener("change", () => { state.sequence = $("sequence").value; changed(false); });
  $("map").addEventListener("change", () => {
    state.map = Number($("map").value);
    say({ do: "map", map: state.map });
    changed(false);
  });
  $("tone").addEventListener("change", () => { state.tone = $("tone").value; locally(); check.draw(); });
  $("marks").addEventListener("change", () => { state.marks = $("marks").checked; locally(); });
  $("wipe").addEventListener("input", () => { state.wipe = $("wipe").valueAsNumber; locally(); });
  $("new-seed").addEventListener("click", nextSeed);
  $("reset-turn").addEventListener("click", () => turn({ yaw: 0, pitch: 0, roll: 0 }, false));
  $("clear-points").addEventListener("click", () => { points = []; plotTried(); });
  $("lights-format").append(...Object.entries(FORMATS).map(([value, text]) => option(value, text)));
  $("save-lights").addEventListener("click", () => say({ do: "save", format: $("lights-format").value, ...wish() }));
  $("save-picture").addEventListener("click", savePicture);
  $("copy-command").addEventListener("click", () => copy($("command").value, $("copy-command")));
  $("copy-link").addEventListener("click", () => copy(location.href, $("copy-link")));
  $("help-button").addEventListener("click", () => $("help").showModal());
  for (const [name, eta] of Object.entries(MATERIALS)) {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: `${name} ${eta}` });
    button.addEventListener("click", () => {
      state.eta = eta;
      say({ do: "fresnel", eta });
      remember();
      showControls();
    });
    $("materials").append(button);
  }
  fresnelKey();
}

function showControls() {
  const { low, most, label } = COUNTS[state.method];
  $("method").value = state.method;
  const sequences = SEQUENCES[state.method];
  $("sequence").replaceChildren(...sequences.map((name) => option(name, SEQUENCE_NAMES[name])));
  if (sequences.length) $("sequence").value = state.sequence;
  $("sequence-row").hidden = $("seed-row").hidden = !sequences.length;
  $("count-label").textContent = label;
  Object.assign($("count-slider"), { min: toSlider(state.method, low), max: toSlider(state.method, most), step: 1 });
  Object.assign($("count"), { min: low, max: most });
  $("tone").value = state.tone;
  $("marks").checked = state.marks;
  $("wipe").value = state.wipe;
  for (const show of shows) show();
}

function choose(method) {
  const kind = COUNTS[method].label !== COUNTS[state.method].label;
  state.method = method;
  if (kind) state.count = COUNTS[method].first;
  fitting(state);
  showControls();
  changed(false);
}

function nextSeed() {
  state.seed += 1;
  showControls();
  changed(false);
}

function turn(by, moving, since) {
  Object.assign(state, by);
  changed(moving, since);
  mustShow = true; // the controls follow with the next picture
}

let remembering = null;
function remember() {
  remembering ??= setTimeout(() => {
    remembering = null;
    if (location.hash !== toAddress(state)) history.replaceState(null, "", toAddress(state));
    if (!isMoving) say({ do: "command", ...wish() });
  }, 300);
}

// ---- dragging the pictures ----

/** Dragging turns the light; `turned` returns the rotation for the pointer's first and current position. */
function draggable(view, turned) {
  let start = null;
  view.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    view.setPointerCapture(event.pointerId);
    start = { x: event.offsetX, y: event.offsetY, matrix: rotation(state), id: event.pointerId };
  });
  view.addEventListener("pointermove", (event) => {
    if (start?.id !== event.pointerId) return;
    const to = { x: event.offsetX, y: event.offsetY };
    const matrix = turned(start, to, event.shiftKey);
    turn(angles(times(matrix, start.matrix)), true, event.timeStamp);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    view.addEventListener(kind, (event) => {
      if (start?.id !== event.pointerId) return;
      start = null;
      changed(false);
    });
  }
}

function buildHands() {
  const sphere = $("sphere-view"), map = $("map-view");
  draggable(sphere, (from, to, rolls) => {
    const side = hasPictures ? $("image-picture").clientWidth : sphereView.places()[0][2] / ($("sphere-canvas").width / $("sphere-canvas").clientWidth);
    if (rolls) return about("z", (2 * (from.x - to.x)) / side);
    return times(about("x", (2 * (to.y - from.y)) / side), about("y", (2 * (to.x - from.x)) / side));
  });
  draggable(map, (from, to) => {
    // The point under the pointer follows it: horizontally by a yaw, vertically by a tilt. A level drag only yaws.
    const phi = (x) => (2 * Math.PI * x) / map.clientWidth, theta = (y) => (Math.PI * y) / map.clientHeight;
    const yaw = about("y", phi(from.x) - phi(to.x));
    from.tilts ||= Math.abs(to.y - from.y) > 8 && Math.abs(to.y - from.y) > 0.5 * Math.abs(to.x - from.x);
    if (!from.tilts) return yaw;
    const axis = [Math.sin(phi(to.x)), 0, -Math.cos(phi(to.x))];
    return times(aboutVector(axis, theta(to.y) - theta(from.y)), yaw);
  });
  for (const view of [sphere, map]) {
    view.addEventListener("keydown", (event) => {
      const step = (event.shiftKey ? 1 : 5) * (Math.PI / 180);
      const by = {
        ArrowLeft: ["y", -step], ArrowRight: ["y", step], ArrowUp: ["x", -step], ArrowDown: ["x", step],
        "[": ["z", step], "]": ["z", -step], "{": ["z", step], "}": ["z", -step],
      }[event.key];
      if (!by || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      event.stopPropagation();
      const [axis, angle] = by;
      turn(angles(times(about(axis, view === map && axis === "y" ? -angle : angle), rotation(state))), true);
      clearTimeout(keysRest);
      keysRest = setTimeout(() => changed(false), 200);
    });
  }
}
let keysRest = null;

const cycle = (list, item, by = 1) => list[(list.indexOf(item) + by + list.length) % list.length];
const press = (id, value) => { $(id).value = value; $(id).dispatchEvent(new Event("change")); };
const next = (id) => () => press(id, cycle([...$(id).options].map((each) => each.value), $(id).value));
const steps = (name, by) => () => press(name, Number((state[name] + by).toFixed(6)));
const scaled = (name, factor) => () => press(name, state[name] * factor);
const counts = (factor) => () => {
  state.count = state.method === "harmonics" ? state.count + (factor > 1 ? 1 : -1) : Math.round(state.count * factor);
  fitting(state);
  showControls();
  changed(false);
};
const KEYS = [
  ["?", "show these shortcuts", () => $("help").showModal()],
  ["1", "Light tab", () => openTab("light")],
  ["2", "Fresnel tab", () => openTab("fresnel")],
  ["3", "Check tab", () => openTab("check")],
  ["m", "next method", () => choose(cycle(Object.keys(SEQUENCES), state.method))],
  ["s", "next sequence", () => {
    if (!SEQUENCES[state.method].length) return;
    state.sequence = cycle(SEQUENCES[state.method], state.sequence);
    showControls();
    changed(false);
  }],
  ["+", "twice as many samples", counts(2)],
  ["-", "half as many samples", counts(0.5)],
  ["n", "next seed", nextSeed],
  ["e", "half a stop brighter", steps("ev", 0.5)],
  ["d", "half a stop darker", steps("ev", -0.5)],
  ["g", "larger gamma, by 0.1", steps("gamma", 0.1)],
  ["G", "smaller gamma, by 0.1", steps("gamma", -0.1)],
  ["h", "highlights clipped or compressed", next("tone")],
  ["c", "twice the scale of the difference", scaled("difference", 2)],
  ["C", "half the scale of the difference", scaled("difference", 0.5)],
  ["a", "larger albedo, by 0.1", steps("albedo", 0.1)],
  ["A", "smaller albedo, by 0.1", steps("albedo", -0.1)],
  ["r", "larger resolution, by 64 pixels", steps("resolution", 64)],
  ["R", "smaller resolution, by 64 pixels", steps("resolution", -64)],
  ["t", "next map", next("map")],
  ["i", "larger refractive index, by 0.1", steps("eta", 0.1)],
  ["I", "smaller refractive index, by 0.1", steps("eta", -0.1)],
  ["w", "wipe: method, half and half, exact image", () => { state.wipe = state.wipe > 50 ? (state.wipe === 100 ? 50 : 100) : state.wipe === 0 ? 100 : 0; showControls(); locally(); }],
  ["x", "show or hide the marks", () => { state.marks = !state.marks; showControls(); locally(); }],
  ["0", "reset the rotation of the light", () => turn({ yaw: 0, pitch: 0, roll: 0 }, false)],
  ["p", "save the picture", () => savePicture()],
];

function buildKeys() {
  const rows = KEYS.map(([key, what]) => [key, what]);
  rows.push(["← → ↑ ↓", "with a picture in focus: turn the light by 5°, or 1° with Shift"], ["[ ]", "with a picture in focus: roll the light"]);
  rows.push(["Shift, drag", "on the sphere: roll the light"]);
  fill($("keys"), rows, false);
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("input:not([type=range]):not([type=checkbox]), select, textarea, dialog");
    if (typing || event.ctrlKey || event.altKey || event.metaKey) return;
    const found = KEYS.find(([key]) => key === event.key || (key === "+" && event.key === "="));
    if (!found) return;
    event.preventDefault();
    found[2]();
  });
}

// ---- tabs, saving, and the rest of the page ----

function openTab(name) {
  state.tab = name;
  for (const each of TABS) {
    $(each).hidden = each !== name;
    $(`tab-${each}`).setAttribute("aria-selected", String(each === name));
    $(`tab-${each}`).tabIndex = each === name ? 0 : -1;
  }
  remember();
  if (name === "light") { plotTried(); plotFollowed(); redraw(); }
  if (name === "fresnel") say({ do: "fresnel", eta: state.eta });
  if (name === "check") check.draw();
}

function buildTabs() {
  for (const name of TABS) $(`tab-${name}`).addEventListener("click", () => openTab(name));
  document.querySelector("[role=tablist]").addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    openTab(cycle(TABS, state.tab, by));
    $(`tab-${state.tab}`).focus();
  });
  document.addEventListener("open-tab", (event) => openTab(event.detail));
  addEventListener("hashchange", () => {
    const before = state.map;
    Object.assign(state, readAddress(location.hash));
    showControls();
    openTab(state.tab);
    if (state.map !== before) say({ do: "map", map: state.map });
    changed(false);
  });
  new ResizeObserver(() => { redraw(); plotTried(); plotFollowed(); check.draw(); }).observe(document.body);
  isDark.addEventListener("change", () => { redraw(); check.draw(); });
}

function banner(text) {
  $("banner").textContent = text;
  $("banner").hidden = !text;
}

async function copy(text, button) {
  const before = button.textContent;
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = "Copied";
  } catch {
    $("command").select();
    button.textContent = "Press Ctrl+C";
  }
  setTimeout(() => (button.textContent = before), 1500);
}

function download(name, blob) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** Saves the map and the spheres, as shown, in one PNG. */
function savePicture() {
  const parts = hasPictures
    ? ["map", "image", "reference", "difference"].map((name) => $(`${name}-picture`))
    : [$("map-canvas"), $("sphere-canvas")];
  const sizes = parts.map((part) => [part.naturalWidth || part.width, part.naturalHeight || part.height]);
  const canvas = document.createElement("canvas");
  canvas.width = Math.max(...sizes.map(([width]) => width));
  canvas.height = sizes.reduce((sum, [, height]) => sum + height, 12 * (parts.length - 1));
  const target = canvas.getContext("2d");
  target.fillStyle = getComputedStyle(document.body).backgroundColor;
  target.fillRect(0, 0, canvas.width, canvas.height);
  let y = 0;
  parts.forEach((part, n) => {
    target.drawImage(part, 0, y);
    y += sizes[n][1] + 12;
  });
  canvas.toBlob((blob) => download("lightdome.png", blob), "image/png");
}

const check = new CheckPage(
  () => ({ tone: { gamma: state.gamma, soft: state.tone === "soft" }, stops: stops(), percent: state.difference, neutral: neutral() }),
  decode,
  () => state.map,
);

try {
  mapView = new MapView($("map-canvas"));
  sphereView = new SphereView($("sphere-canvas"));
} catch {
  hasPictures = true;
  document.body.classList.add("pictures");
  for (const name of ["map", "image", "reference", "difference"]) $(`${name}-picture`).hidden = false;
  $("numbers-note").after(Object.assign(document.createElement("p"), { className: "small", textContent: "This browser has no WebGL 2, so the pictures come from the server." }));
}
globalThis.lightdomeView.hasPictures = hasPictures;
buildControls();
buildHands();
buildKeys();
buildTabs();
showControls();
openTab(state.tab);
plotTried();
connect();
