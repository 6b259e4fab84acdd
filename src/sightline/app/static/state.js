// State of the page, kept in the address: what the server needs, and how it is looked at.

import { keyOf } from "./files.js";

export const BEAMS = [64, 48, 32, 16, 8, 4]; // severity of lidar_beams by position, 0: none
export const COLOURS = ["height", "range", "reflectance", "image", "fault"];
export const SIDES = ["broken", "clean", "both"];
export const GATES = ["none", "camera", "lidar"];

const VIEW = {
  score: 0.3, compare: "both", boxes2d: true, projected: true, labels: false, gates: "none",
  colour: "height", depth: "depth", follow: false, camera: null, theme: null, selected: null,
};
const CHOICES = {
  compare: SIDES, gates: GATES, colour: COLOURS, depth: ["depth", "uncertainty"],
  theme: ["light", "dark"],
};

// Reads a state from a link; what is missing or wrong is as at first.
export function parse(search, setup) {
  const query = new URLSearchParams(search);
  const frame = query.get("frame");
  const state = {
    frame: setup.frames.includes(frame) ? frame : setup.frames[0],
    faults: query.getAll("fault").map(parseFault).filter((each) => isFault(each, setup)),
    yaw: within(query.get("yaw"), -setup.limits.yaw_deg, setup.limits.yaw_deg, 0),
    weights: {},
    view: structuredClone(VIEW),
  };
  for (const [task, offered] of Object.entries(setup.tasks)) {
    const chosen = query.get(task);
    state.weights[task] = offered.includes(chosen) ? chosen : setup.fast[task];
  }
  const view = state.view;
  view.score = within(query.get("score"), 0, 1, VIEW.score);
  for (const name of ["boxes2d", "projected", "labels", "follow"]) {
    if (query.has(name)) view[name] = query.get(name) === "1";
  }
  for (const [name, offered] of Object.entries(CHOICES)) {
    if (offered.includes(query.get(name))) view[name] = query.get(name);
  }
  const camera = (query.get("camera") ?? "").split(",").map(Number);
  if (camera.length === 6 && camera.every(Number.isFinite)) view.camera = camera;
  if (/^[cb]\d{1,4}$/.test(query.get("selected") ?? "")) view.selected = query.get("selected");
  return state;
}

// Names and values of a link, of those predictions depend on, that its state lacks.
export function refused(search, state, setup) {
  const known = new URLSearchParams(asked(state, setup));
  const names = new Set(["frame", "fault", "yaw", ...Object.keys(setup.tasks)]);
  return [...new URLSearchParams(search)].filter(([name, value]) => names.has(name)
    && !known.getAll(name).includes(value)
    && !(name === "yaw" && Number(value) === state.yaw) && state.weights[name] !== value)
    .map((each) => each.join(" "));
}

// The query that the server understands: what predictions depend on.
export function asked(state, setup) {
  const query = new URLSearchParams({ frame: state.frame });
  for (const each of state.faults) {
    query.append("fault", `${each.kind}.${each.severity}.${each.seed}`);
  }
  if (state.yaw) query.set("yaw", state.yaw);
  for (const [task, chosen] of Object.entries(state.weights)) {
    if (chosen !== setup.fast[task]) query.set(task, chosen);
  }
  return query.toString();
}

// The query of the whole page.
export function permalink(state, setup) {
  const query = new URLSearchParams(asked(state, setup));
  for (const [name, value] of Object.entries(state.view)) {
    const same = JSON.stringify(value) === JSON.stringify(VIEW[name]);
    if (same || value === null) continue;
    query.set(name, typeof value === "boolean" ? Number(value) : value);
  }
  return query.toString();
}

// The same frame with sound sensors.
export function clean(state) {
  return { ...state, faults: [], yaw: 0 };
}

// Whether a state can be shown: every one by a server, else those that were computed beforehand.
export function has(state, setup) {
  return !setup.states || keyOf(asked(state, setup)) in setup.states;
}

// The first of some changes of a state that can be shown; undefined: none can.
export function firstOf(state, changes, setup) {
  return changes.find((each) => has({ ...state, ...each }, setup));
}

export function isBroken(state) {
  return state.faults.length > 0 || state.yaw !== 0;
}

// The faults of a state in words.
export function brokenBy({ faults, yaw }) {
  const words = faults.map(({ kind, severity }) => `${kind.replaceAll("_", " ")} (severity ${severity})`);
  return [...words, ...(yaw ? [`LiDAR turned by ${yaw}\u00b0`] : [])].join(", ");
}

function parseFault(text) {
  const [kind, severity, seed] = text.split(".");
  return { kind, severity: Number(severity), seed: Number(seed) };
}

function isFault({ kind, severity, seed }, setup) {
  const isWhole = Number.isInteger(severity) && Number.isInteger(seed);
  const isKnown = setup.kinds.some((each) => each.name === kind);
  return isKnown && isWhole && severity >= 1 && severity <= 5 && seed >= 0
    && seed <= setup.limits.seed;
}

function within(text, lowest, highest, otherwise) {
  const value = Number(text);
  return text !== null && text !== "" && value >= lowest && value <= highest ? value : otherwise;
}
