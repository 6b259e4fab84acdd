// Objects of the clean and the broken sensors, paired, and their table.

import { boxOf, distance, iou } from "./geometry.js";

const MIN_IOU = 0.3;
const MAX_METRES = 2.5;

// The list of objects of one side's parts, from a score on: joined, else of one detector.
export function found(parts, minScore) {
  const objects = parts.joined?.objects ?? single(parts);
  return objects === null ? null : objects.filter((each) => each.score >= minScore);
}

function single(parts) {
  const image = parts.detection2d?.detections2d;
  const sweep = parts.detection3d?.detections3d;
  if (!image && !sweep) return null;
  if (parts.detection3d && image === undefined) {
    return sweep.map((each) => ({ class: each.class, score: each.score, box_px: null, box_3d: each }));
  }
  return (image ?? []).map((each) => ({ ...each, box_3d: null }));
}

// Pairs objects of both sides: the surest first, each with the best free one of its class.
export function pairUp(cleanObjects, brokenObjects) {
  const free = new Set((brokenObjects ?? []).keys());
  const rows = (cleanObjects ?? []).map((object, index) => {
    let best = null;
    let most = 0;
    for (const other of free) {
      const value = likeness(object, brokenObjects[other]);
      if (value > most) [best, most] = [other, value];
    }
    if (best !== null) free.delete(best);
    const broken = best === null ? null : brokenObjects[best];
    return { id: `c${index}`, clean: object, broken, state: broken ? "kept" : "lost" };
  });
  for (const index of free) {
    rows.push({ id: `b${index}`, clean: null, broken: brokenObjects[index], state: "new" });
  }
  if (cleanObjects === brokenObjects) return rows.map((each) => ({ ...each, state: "found" }));
  if (!brokenObjects) return rows.map((each) => ({ ...each, state: "..." }));
  return cleanObjects ? rows : rows.map((each) => ({ ...each, state: "..." }));
}

function likeness(a, b) {
  if (a.class !== b.class) return 0;
  const inImage = iou(a.box_px, b.box_px);
  if (inImage >= MIN_IOU) return 1 + inImage;
  const [boxA, boxB] = [boxOf(a), boxOf(b)];
  const apart = boxA && boxB ? distance(boxA.slice(0, 3), boxB.slice(0, 3)) : Infinity;
  return apart <= MAX_METRES ? 1 - apart / (2 * MAX_METRES) : 0;
}

export function fillTable(body, rows, selected, colors, select) {
  const focused = document.activeElement?.dataset?.object;
  body.replaceChildren(...rows.map((row) => tableRow(row, selected, colors, select)));
  if (focused) body.querySelector(`[data-object="${focused}"]`)?.focus();
}

function tableRow(row, selected, colors, select) {
  const shown = row.broken ?? row.clean;
  const line = document.createElement("tr");
  line.dataset.selected = String(row.id === selected);
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.object = row.id;
  button.setAttribute("aria-pressed", String(row.id === selected));
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  swatch.style.background = `rgb(${(colors[shown.class] ?? [235, 235, 235]).join(",")})`;
  button.append(swatch, shown.class);
  button.addEventListener("click", () => select(row.id === selected ? null : row.id));
  const box = boxOf(shown);
  const metres = box ? `${Math.hypot(box[0], box[1]).toFixed(1)} m` : "-";
  const cells = [
    null, row.state, percent(row.clean), percent(row.broken), metres,
    shown.box_3d?.origin ?? (box ? "measured" : "none"), shown.support?.points ?? "-",
  ];
  cells.forEach((text, index) => {
    const cell = document.createElement("td");
    if (index === 0) cell.append(button);
    else cell.textContent = text;
    if (index === 1) cell.className = row.state;
    line.append(cell);
  });
  return line;
}

function percent(object) {
  return object ? object.score.toFixed(2) : "-";
}
