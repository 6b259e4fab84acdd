// The form: shows the state and changes it.

import { BEAMS } from "./state.js";

const BEAMS_KIND = "lidar_beams";
const PRESETS = {
  "Sound sensors": { faults: [], yaw: 0 },
  "Camera blank": { faults: [{ kind: "camera_blank", severity: 5, seed: 0 }] },
  "LiDAR blank": { faults: [{ kind: "lidar_blank", severity: 5, seed: 0 }] },
  "8 beams": { faults: [{ kind: BEAMS_KIND, severity: 4, seed: 0 }] },
  "Fog": { faults: [{ kind: "camera_fog", severity: 4, seed: 0 }, { kind: "lidar_fog", severity: 4, seed: 0 }] },
  "Turned 2 degrees": { faults: [], yaw: 2 },
};
const at = (id) => document.getElementById(id);

// Connects the form: `changed(isAsked)` is called after each change of the state.
export function connect(state, setup, changed) {
  at("frame").replaceChildren(...setup.frames.map((name) => option(name)));
  at("presets").replaceChildren(...Object.entries(PRESETS).map(([title, preset]) =>
    button(title, () => {
      Object.assign(state, { yaw: 0 }, structuredClone(preset));
      changed(true);
    })));
  at("frame").addEventListener("change", (event) => goTo(state, setup, event.target.value, changed));
  at("previous").addEventListener("click", () => step(state, setup, -1, changed));
  at("next").addEventListener("click", () => step(state, setup, 1, changed));
  at("add-fault").addEventListener("click", () => {
    const taken = new Set(state.faults.map((each) => each.kind));
    const kind = setup.kinds.find((each) => !taken.has(each.name)).name;
    state.faults.push({ kind, severity: 3, seed: 0 });
    changed(true);
    at("faults").lastElementChild.querySelector("select").focus();
  });
  at("beams").addEventListener("input", (event) => {
    const severity = Number(event.target.value);
    state.faults = state.faults.filter((each) => each.kind !== BEAMS_KIND);
    if (severity && state.faults.length < setup.limits.faults) {
      state.faults.push({ kind: BEAMS_KIND, severity, seed: 0 });
    }
    changed(true);
  });
  at("yaw").addEventListener("input", (event) => {
    state.yaw = Number(event.target.value);
    changed(true);
  });
  at("score").addEventListener("input", (event) => {
    state.view.score = Number(event.target.value);
    changed(false);
  });
  for (const radio of document.querySelectorAll("[name=preset]")) {
    radio.addEventListener("change", () => {
      if (radio.value !== "own") Object.assign(state.weights, setup[radio.value]);
      else at("weights").hidden = false;
      changed(true);
    });
  }
  for (const radio of document.querySelectorAll("[name=compare]")) {
    radio.addEventListener("change", () => set(state.view, "compare", radio.value, changed));
  }
  for (const name of ["boxes2d", "projected", "labels", "follow"]) {
    at(name).addEventListener("change", (event) => set(state.view, name, event.target.checked, changed));
  }
  for (const name of ["gates", "colour", "depth"]) {
    at(name).addEventListener("change", (event) => set(state.view, name, event.target.value, changed));
  }
  at("weights").replaceChildren(...Object.entries(setup.tasks).map(([task, offered]) => {
    const label = document.createElement("label");
    const select = document.createElement("select");
    select.id = `weights-${task}`;
    select.replaceChildren(...offered.map((name) => option(name)));
    select.addEventListener("change", () => set(state.weights, task, select.value, () => changed(true)));
    label.append(task, select);
    return label;
  }));
  at("controls").addEventListener("submit", (event) => event.preventDefault());
}

// Shows a state in the form.
export function show(state, setup, changed) {
  const view = state.view;
  at("frame").value = state.frame;
  const beams = state.faults.find((each) => each.kind === BEAMS_KIND)?.severity ?? 0;
  at("beams").value = beams;
  at("beams-out").value = `${beams ? BEAMS[beams] : "all"}${beams ? " of 64" : ""}`;
  at("beams").setAttribute("aria-valuetext", at("beams-out").value);
  at("yaw").value = state.yaw;
  at("yaw-out").value = `${state.yaw.toFixed(2)}\u00b0`;
  at("score").value = view.score;
  at("score-out").value = view.score.toFixed(2);
  for (const name of ["boxes2d", "projected", "labels", "follow"]) at(name).checked = view[name];
  for (const name of ["gates", "colour", "depth"]) at(name).value = view[name];
  document.querySelector(`[name=compare][value=${view.compare}]`).checked = true;
  const preset = ["fast", "best"].find((name) =>
    Object.entries(setup[name]).every(([task, chosen]) => state.weights[task] === chosen)) ?? "own";
  const radio = document.querySelector(`[name=preset][value=${preset}]`);
  const keepsOwn = document.querySelector("[name=preset][value=own]").checked && document.activeElement.closest?.("#weights, .choice");
  if (!keepsOwn) radio.checked = true;
  at("weights").hidden = preset !== "own" && !keepsOwn;
  for (const [task, chosen] of Object.entries(state.weights)) at(`weights-${task}`).value = chosen;
  showFaults(state, setup, changed);
}

export function step(state, setup, by, changed) {
  const index = setup.frames.indexOf(state.frame) + by;
  if (setup.frames[index]) goTo(state, setup, setup.frames[index], changed);
}

function goTo(state, setup, frame, changed) {
  state.frame = frame;
  changed(true);
}

// One line for each fault; lines stay as they are while the kinds do, so that sliders can be dragged.
function showFaults(state, setup, changed) {
  const list = at("faults");
  const kinds = state.faults.map((each) => each.kind).join();
  if (list.dataset.kinds !== kinds) {
    list.dataset.kinds = kinds;
    list.replaceChildren(...state.faults.map((_, index) => faultLine(state, setup, index, changed)));
  }
  state.faults.forEach((fault, index) => {
    const [kind, severity, seed, level] = list.children[index].querySelectorAll("select, input, small");
    [kind.value, severity.value, seed.value] = [fault.kind, fault.severity, fault.seed];
    const described = setup.kinds.find((each) => each.name === fault.kind).levels[fault.severity - 1];
    level.textContent = `severity ${fault.severity}: ${described}`;
    severity.setAttribute("aria-valuetext", level.textContent);
  });
  at("add-fault").disabled = state.faults.length >= setup.limits.faults;
}

function faultLine(state, setup, index, changed) {
  const line = document.createElement("li");
  const top = document.createElement("div");
  const below = document.createElement("div");
  top.className = below.className = "line";
  const kind = document.createElement("select");
  kind.setAttribute("aria-label", "Kind of fault");
  const taken = new Set(state.faults.map((each) => each.kind));
  kind.replaceChildren(...setup.kinds.map((each) => {
    const made = option(each.name, each.name.replaceAll("_", " "));
    made.disabled = taken.has(each.name) && each.name !== state.faults[index].kind;
    return made;
  }));
  kind.addEventListener("change", () => set(state.faults[index], "kind", kind.value, () => changed(true)));
  const severity = input("range", "Severity", { min: 1, max: 5, step: 1 });
  severity.addEventListener("input", () =>
    set(state.faults[index], "severity", Number(severity.value), () => changed(true)));
  const seed = input("number", "Seed", { min: 0, max: setup.limits.seed, step: 1 });
  seed.title = "seed";
  seed.addEventListener("change", () => {
    const value = Math.max(0, Math.min(setup.limits.seed, Math.round(Number(seed.value) || 0)));
    set(state.faults[index], "seed", value, () => changed(true));
  });
  top.append(kind, button("\u2715", () => {
    state.faults.splice(index, 1);
    changed(true);
    at("add-fault").focus();
  }, "Remove this fault"));
  below.append(severity, seed);
  line.append(top, below, document.createElement("small"));
  return line;
}

function set(place, name, value, changed) {
  place[name] = value;
  changed(false);
}

function input(type, label, settings) {
  const made = Object.assign(document.createElement("input"), { type, ...settings });
  made.setAttribute("aria-label", label);
  return made;
}

function option(value, text = value) {
  return Object.assign(document.createElement("option"), { value, textContent: text });
}

function button(text, act, label) {
  const made = Object.assign(document.createElement("button"), { type: "button", textContent: text });
  if (label) made.setAttribute("aria-label", label);
  made.addEventListener("click", act);
  return made;
}
