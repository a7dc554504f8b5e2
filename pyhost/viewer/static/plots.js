// Plots as SVG. Marks and dashes repeat whatever a colour says.

const NS = "http://www.w3.org/2000/svg";

export function element(parent, name, attributes = {}, text = null) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  parent.append(made);
  return made;
}

/** The points that no other beats in both time and error, by increasing time, as in lightdome.evaluation.metrics. */
export function paretoFront(points) {
  const front = [];
  for (const point of [...points].sort((a, b) => a.x - b.x || a.y - b.y)) {
    if (!front.length || point.y < front[front.length - 1].y) front.push(point);
  }
  return front;
}

/** A number with three digits, with an exponent only if it needs one. */
export function short(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-4) return value.toExponential(1).replace("e+", "e").replace("-", "−");
  return String(Number(value.toPrecision(3)));
}

/** Both ends of a scale around 0. */
export const ends = (value) => ["−", "+"].map((sign) => sign + short(Number(value.toPrecision(2))));

export const thousands = (count) => (count >= 1000 ? `${count / 1000}k` : String(count));

export const percent = (share) => (share === 0 ? "0 %" : share < 1e-6 ? `${short(100 * share)} %` : `${Number((100 * share).toPrecision(3))} %`);

function decades(values, least) {
  let low = Math.floor(Math.log10(Math.min(...values)) + 1e-9), high = Math.ceil(Math.log10(Math.max(...values)) - 1e-9);
  if (high - low < least) high = low + least;
  return [low, high];
}

/**
 * A plot with two logarithmic axes. Series are { points: [{ x, y, label }], kind: "line" | "marks" | "front" | "now" }.
 */
export function logLog(svg, series, { x: labelX, y: labelY, formatX = short, formatY = percent }) {
  svg.replaceChildren();
  const width = svg.clientWidth || 300, height = 210;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const all = series.flatMap((each) => each.points).filter(({ x, y }) => x > 0 && y > 0);
  if (!all.length) {
    element(svg, "text", { x: width / 2, y: height / 2, "text-anchor": "middle", class: "label" }, "no points yet");
    return;
  }
  const [left, right, top, bottom] = [52, width - 10, 10, height - 38];
  const [x0, x1] = decades(all.map(({ x }) => x), 1), [y0, y1] = decades(all.map(({ y }) => y), 1);
  const px = (x) => left + ((Math.log10(x) - x0) / (x1 - x0)) * (right - left);
  const py = (y) => bottom - ((Math.log10(y) - y0) / (y1 - y0)) * (bottom - top);
  const every = Math.ceil((x1 - x0) / 6);
  for (let n = x0; n <= x1; n += every) {
    element(svg, "line", { x1: px(10 ** n), x2: px(10 ** n), y1: top, y2: bottom, class: "grid" });
    element(svg, "text", { x: px(10 ** n), y: bottom + 14, "text-anchor": n === x1 ? "end" : "middle", class: "label" }, formatX(10 ** n));
  }
  for (let n = y0; n <= y1; n++) {
    element(svg, "line", { x1: left, x2: right, y1: py(10 ** n), y2: py(10 ** n), class: "grid" });
    element(svg, "text", { x: left - 5, y: py(10 ** n) + 4, "text-anchor": "end", class: "label" }, formatY(10 ** n));
  }
  element(svg, "text", { x: (left + right) / 2, y: height - 6, "text-anchor": "middle", class: "axis" }, labelX);
  element(svg, "text", { x: 11, y: (top + bottom) / 2, "text-anchor": "middle", class: "axis", transform: `rotate(-90 11 ${(top + bottom) / 2})` }, labelY);
  for (const { points, kind } of series) {
    const shown = points.filter(({ x, y }) => x > 0 && y > 0);
    if (kind === "line" || kind === "front") {
      let path = "";
      shown.forEach(({ x, y }, n) => {
        path += n === 0 ? `M${px(x)} ${py(y)}` : kind === "front" ? `H${px(x)}V${py(y)}` : `L${px(x)} ${py(y)}`;
      });
      element(svg, "path", { d: path, class: kind });
    }
    if (kind === "front") continue;
    for (const { x, y, label } of shown) {
      const mark = element(svg, "circle", { cx: px(x), cy: py(y), r: kind === "now" ? 6 : 3, class: kind });
      if (label) element(mark, "title", {}, label);
    }
  }
}

/** Reflectance against the angle of incidence: curves by name, and vertical lines with labels. */
export function reflectances(svg, curves, lines) {
  svg.replaceChildren();
  const width = svg.clientWidth || 420, height = Math.round(Math.min(380, Math.max(240, 0.62 * width)));
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const [left, right, top, bottom] = [42, width - 12, 36, height - 40];
  const px = (degrees) => left + (degrees / 90) * (right - left), py = (value) => bottom - value * (bottom - top);
  for (let degrees = 0; degrees <= 90; degrees += 15) {
    element(svg, "line", { x1: px(degrees), x2: px(degrees), y1: top, y2: bottom, class: "grid" });
    element(svg, "text", { x: px(degrees), y: bottom + 15, "text-anchor": "middle", class: "label" }, String(degrees));
  }
  for (let tenths = 0; tenths <= 10; tenths += 2) {
    element(svg, "line", { x1: left, x2: right, y1: py(tenths / 10), y2: py(tenths / 10), class: "grid" });
    element(svg, "text", { x: left - 6, y: py(tenths / 10) + 4, "text-anchor": "end", class: "label" }, String(tenths / 10));
  }
  element(svg, "text", { x: (left + right) / 2, y: height - 6, "text-anchor": "middle", class: "axis" }, "angle of incidence, degrees");
  element(svg, "text", { x: 11, y: (top + bottom) / 2, "text-anchor": "middle", class: "axis", transform: `rotate(-90 11 ${(top + bottom) / 2})` }, "reflectance");
  for (const { degrees, label, row } of lines) {
    element(svg, "line", { x1: px(degrees), x2: px(degrees), y1: top, y2: bottom, class: "special" });
    const end = px(degrees) > (left + right) / 2 ? "end" : "start";
    element(svg, "text", { x: px(degrees), y: top - 5 - 15 * row, "text-anchor": end, class: "note" }, label);
  }
  for (const [name, { degrees, values }] of Object.entries(curves)) {
    const path = degrees.map((x, n) => `${n ? "L" : "M"}${px(x).toFixed(2)} ${py(values[n]).toFixed(2)}`).join("");
    element(svg, "path", { d: path, class: `curve ${name}` });
  }
}
