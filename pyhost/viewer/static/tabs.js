// The tabs for Fresnel reflectance and for checking an image.

import { SphereView } from "./draw.js";
import { ends, percent, reflectances, short } from "./plots.js";

const $ = (id) => document.getElementById(id);

export const MATERIALS = { Water: 1.33, Handout: 1.4, Glass: 1.5, Sapphire: 1.77, Diamond: 2.42 };
const CURVES = { s: "s, perpendicular", p: "p, parallel", unpolarised: "unpolarised", schlick: "Schlick's approximation" };

export function showFresnel({ summary, curves }) {
  for (const name of ["entering", "leaving"]) {
    const { degrees } = curves[name];
    const drawn = Object.fromEntries(Object.keys(CURVES).map((key) => [key, { degrees, values: curves[name][key] }]));
    const lines = [];
    const brewster = summary[`brewster_${name}_deg`], critical = summary[`critical_${name}_deg`];
    if (brewster !== null) lines.push({ degrees: brewster, label: `Brewster ${brewster.toFixed(2)}°`, row: 0 });
    if (critical !== null) lines.push({ degrees: critical, label: `critical ${critical.toFixed(2)}°`, row: 1 });
    reflectances($(name), drawn, lines);
  }
  const angle = (value) => (value === null ? "none" : `${value.toFixed(4)}°`);
  const rows = [
    ["", "entering", "leaving"],
    ["Reflectance at normal incidence", ...Array(2).fill(percent(summary.schlick_r0))],
    ["Brewster's angle: no p-polarised light is reflected", angle(summary.brewster_entering_deg), angle(summary.brewster_leaving_deg)],
    ["Critical angle: all light is reflected beyond it", angle(summary.critical_entering_deg), angle(summary.critical_leaving_deg)],
    ["Schlick's largest error", short(summary.schlick_entering_max_abs_error), short(summary.schlick_leaving_max_abs_error)],
    ["… at an angle of", angle(summary.schlick_entering_max_abs_error_at_deg), angle(summary.schlick_leaving_max_abs_error_at_deg)],
  ];
  fill($("fresnel-table"), rows);
}

export function fresnelKey() {
  for (const [name, text] of Object.entries(CURVES)) {
    const label = document.createElement("span");
    label.innerHTML = `<svg width="34" height="10" aria-hidden="true"><path d="M2 5H32" class="curve ${name}"/></svg>`;
    label.append(text);
    $("fresnel-key").append(label);
  }
}

/** Fills a table; its first row is a heading unless `hasHead` is false. */
export function fill(table, rows, hasHead = true) {
  table.replaceChildren(
    ...rows.map((cells, n) => {
      const row = document.createElement("tr");
      row.append(
        ...cells.map((text, column) => {
          const cell = document.createElement(column === 0 || (hasHead && n === 0) ? "th" : "td");
          cell.scope = column === 0 ? "row" : "col";
          cell.textContent = text;
          return cell;
        }),
      );
      return row;
    }),
  );
}

const MOST_BYTES = 2 ** 26;

export class CheckPage {
  /** `look` returns what all pictures share: exposure, gamma, colours; `decode` unpacks an answer. */
  constructor(look, decode, mapNumber) {
    Object.assign(this, { look, decode, mapNumber, view: null, brightest: 0 });
    $("file").addEventListener("change", () => $("file").files.length && this.send($("file").files[0]));
    $("check-kind").addEventListener("change", () => ($("check-count-row").hidden = $("check-kind").value === ""));
    $("check-wipe").addEventListener("input", () => this.draw());
    const drop = $("drop");
    for (const kind of ["dragover", "drop", "dragleave"]) {
      document.addEventListener(kind, (event) => {
        event.preventDefault(); // or the browser leaves the page and opens the file
        drop.classList.toggle("over", kind === "dragover");
        if (kind === "drop" && event.dataTransfer.files.length) {
          document.dispatchEvent(new CustomEvent("open-tab", { detail: "check" }));
          this.send(event.dataTransfer.files[0]);
        }
      });
    }
  }

  async send(file) {
    const verdict = $("verdict"), suffix = /\.[^.]*$/.exec(file.name)?.[0].toLowerCase() ?? "";
    $("file").value = "";
    const fail = (text) => {
      verdict.className = "card unknown";
      verdict.replaceChildren(heading("Not checked"), paragraph(`${file.name}: ${text}`));
      $("check-pictures").hidden = true;
    };
    if (![".pfm", ".exr", ".hdr"].includes(suffix)) return fail("choose a .pfm, .exr or .hdr file; other formats do not hold radiance");
    if (file.size > MOST_BYTES) return fail(`a file may have at most ${MOST_BYTES / 2 ** 20} MiB`);
    verdict.className = "card busy";
    verdict.replaceChildren(heading("Checking …"), paragraph(file.name));
    const options = new URLSearchParams({ suffix, map: this.mapNumber(), albedo: $("check-albedo").value });
    if ($("check-kind").value) options.set($("check-kind").value, $("check-count").value);
    try {
      const answer = await fetch(`check?${options}`, { method: "POST", body: file });
      if (!answer.ok) return fail((await answer.json().catch(() => ({}))).error ?? `the server answered with status ${answer.status}`);
      this.show(file.name, this.decode(await answer.arrayBuffer()));
    } catch {
      fail("the server did not answer");
    }
  }

  show(name, { header, arrays }) {
    const verdict = $("verdict"), { expected } = header;
    verdict.className = `card ${header.agrees === true ? "right" : header.agrees === false ? "wrong" : "unknown"}`;
    const sign = header.agrees === true ? "✓ " : header.agrees === false ? "✗ " : "? ";
    const rows = [["Relative RMSE", percent(header.relative_rmse)]];
    if (expected) {
      const per = expected.per_pixel ? "samples per pixel" : "samples";
      rows.push([`Expected with ${expected.samples} ${per}`, `${percent(expected.relative_rmse_mean)}; 90 % of images from ${percent(expected.relative_rmse_5_percent)} to ${percent(expected.relative_rmse_95_percent)}`]);
    }
    if (header.deviations !== null) rows.push(["Deviation", `${header.deviations.toFixed(1)} standard deviations`]);
    const rgb = (values, show) => `red ${show(values[0])}, green ${show(values[1])}, blue ${show(values[2])}`;
    rows.push(["Bias by channel", rgb(header.bias_relative_rgb, signed)]);
    rows.push(["Factors by channel", rgb(header.factor_rgb, short)]);
    if (header.orientation) rows.push(["Orientation", header.orientation]);
    const [x, y] = header.largest_error_at_pixel;
    rows.push(["Largest error", `${short(header.largest_error_radiance)} radiance, at x = ${x}, y = ${y}`]);
    const parts = [heading(sign + capital(header.verdict)), paragraph(`${name}, ${header.file_width} × ${header.file_height} pixels`)];
    if (header.cause_told) parts.push(paragraph(`Symptom: ${header.cause_told.seen}`), paragraph(`Where to look: ${header.cause_told.where}`));
    const table = document.createElement("table");
    fill(table, rows, false);
    verdict.replaceChildren(...parts, table);
    $("check-pictures").hidden = false;
    try {
      this.view ??= new SphereView($("check-canvas"));
    } catch {
      $("check-pictures").hidden = true; // without WebGL, the numbers must do
      return;
    }
    this.view.image.put(arrays.image);
    this.view.reference.put(arrays.reference);
    this.brightest = arrays.reference.data.reduce((most, value) => Math.max(most, value), 0);
    const sorted = arrays.reference.data.filter((value) => value > 0).sort();
    this.exposure = sorted.length ? 1 / sorted[Math.floor(0.97 * sorted.length)] : 1;
    this.draw();
  }

  draw() {
    if (!this.view || $("check-pictures").hidden) return;
    const look = this.look();
    const difference = (look.percent / 100) * (this.brightest || 1);
    [$("check-low").textContent, $("check-high").textContent] = ends(difference);
    const tone = { ...look.tone, exposure: this.exposure * look.stops };
    this.view.draw({ wipe: $("check-wipe").value / 100, difference, albedo: 1, neutral: look.neutral, tone });
  }
}

const signed = (share) => `${share < 0 ? "−" : "+"}${Math.abs(100 * share).toFixed(2)} %`;
const capital = (text) => text[0].toUpperCase() + text.slice(1);

function heading(text) {
  const made = document.createElement("h2");
  made.textContent = text;
  return made;
}

function paragraph(text) {
  const made = document.createElement("p");
  made.textContent = text;
  return made;
}
