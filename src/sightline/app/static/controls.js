// The form: shows the state and changes it.

import { BEAMS, asked, firstOf, has } from "./state.js";

const BEAMS_KIND = "lidar_beams";
const SEVERITIES = [1, 2, 3, 4, 5];
const WHY = "not computed when this page was exported";
const at = (id) => document.getElementById(id);

// Connects the form: `changed(isAsked)` is called after each change of the state.
export function connect(state, setup, changed) {
  at("frame").replaceChildren(...setup.frames.map((name) => option(name)));
  at("presets").replaceChildren(...setup.presets.map(({ name, faults, yaw }) =>
    button(name, () => apply(state, { faults, yaw }, changed))));
  at("exported").hidden = !setup.states;
  at("frame").addEventListener("change", (event) => goTo(state, setup, event.target.value, changed));
  at("previous").addEventListener("click", () => step(state, setup, -1, changed));
  at("next").addEventListener("click", () => step(state, setup, 1, changed));
  at("add-fault").addEventListener("click", () => {
    apply(state, added(state, setup), changed);
    at("faults").lastElementChild.querySelector("select").focus();
  });
  at("beams").addEventListener("input", (event) =>
    apply(state, beams(state, setup)[Number(event.target.value)].change, changed));
  at("yaw").addEventListener("input", (event) => {
    const offered = yaws(state, setup);
    const value = Number(event.target.value);
    apply(state, offered ? offered[value].change : { yaw: value }, changed);
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
  setup.presets.forEach(({ faults, yaw }, index) => {
    const preset = { ...state, faults, yaw };
    enable(at("presets").children[index], has(preset, setup));
    at("presets").children[index].setAttribute("aria-pressed", String(asked(preset, setup) === asked(state, setup)));
  });
  showBeams(beams(state, setup));
  showYaw(state, yaws(state, setup));
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
  for (const each of document.querySelectorAll("[name=preset]")) {
    const weights = { ...state.weights, ...setup[each.value] };
    enable(each, each.value === "own" ? !setup.states : has({ ...state, weights }, setup));
  }
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

// Positions of the slider of beams: those that can be shown, beside the other faults or alone.
function beams(state, setup) {
  const others = state.faults.filter((each) => each.kind !== BEAMS_KIND);
  return [0, ...SEVERITIES].flatMap((severity) => {
    const own = severity ? [{ kind: BEAMS_KIND, severity, seed: 0 }] : [];
    const together = [...others, ...own].slice(0, setup.limits.faults);
    const change = firstOf(state, [{ faults: together }, { faults: own, yaw: 0 }], setup);
    return change ? [{ severity, change, isNow: isAmong(state.faults, own) }] : [];
  });
}

function isAmong(faults, [own]) {
  const now = faults.find((each) => each.kind === BEAMS_KIND);
  return now ? now.severity === own?.severity : !own;
}

function showBeams(offered) {
  const now = Math.max(0, offered.findIndex((each) => each.isNow));
  const severity = offered[now]?.severity ?? 0;
  through(at("beams"), offered, now);
  at("beams-out").value = `${severity ? BEAMS[severity] : "all"}${severity ? " of 64" : ""}`;
  at("beams").setAttribute("aria-valuetext", at("beams-out").value);
}

// Positions of the slider of the yaw in an exported page; null: every angle can be shown.
function yaws(state, setup) {
  if (!setup.states) return null;
  return setup.yaws.flatMap((yaw) => {
    const change = firstOf(state, [{ yaw }, { faults: [], yaw }], setup);
    return change ? [{ yaw, change }] : [];
  });
}

function showYaw(state, offered) {
  if (offered) through(at("yaw"), offered, Math.max(0, offered.findIndex((each) => each.yaw === state.yaw)));
  else at("yaw").value = state.yaw;
  at("yaw-out").value = `${state.yaw.toFixed(2)}\u00b0`;
  at("yaw").setAttribute("aria-valuetext", at("yaw-out").value);
}

// Makes a slider's positions those of a list.
function through(slider, offered, now) {
  Object.assign(slider, { min: 0, max: Math.max(0, offered.length - 1), step: 1, value: now });
  enable(slider, offered.length > 1);
}

// The change that adds a fault; undefined: none can be added.
function added(state, setup) {
  const taken = new Set(state.faults.map((each) => each.kind));
  const free = setup.kinds.filter((each) => !taken.has(each.name));
  const faults = [3, ...SEVERITIES].flatMap((severity) =>
    free.map(({ name }) => [...state.faults, { kind: name, severity, seed: 0 }]));
  return firstOf(state, faults.map((each) => ({ faults: each })), setup);
}

// The change that makes a fault another one: of this severity, else of the first that can be shown.
function replaced(state, setup, index, kind) {
  const { severity, seed } = state.faults[index];
  const faults = [severity, ...SEVERITIES].map((each) =>
    state.faults.with(index, { kind, severity: each, seed }));
  return firstOf(state, faults.map((each) => ({ faults: each })), setup);
}

// Severities of a fault that can be shown, as positions of its slider.
function severities(state, setup, index) {
  return SEVERITIES.flatMap((severity) => {
    const faults = state.faults.with(index, { ...state.faults[index], severity });
    return has({ ...state, faults }, setup) ? [{ severity, change: { faults } }] : [];
  });
}

function without(state, index) {
  return { faults: state.faults.toSpliced(index, 1) };
}

function apply(state, change, changed) {
  Object.assign(state, structuredClone(change));
  changed(true);
}

function enable(control, isOffered) {
  control.disabled = !isOffered;
  control.title = isOffered ? "" : WHY;
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
    const line = list.children[index];
    const [kind, severity, seed, level] = line.querySelectorAll("select, input, small");
    const offered = severities(state, setup, index);
    [kind.value, seed.value] = [fault.kind, fault.seed];
    Object.assign(severity, { min: 1, max: offered.length, step: 1 });
    severity.value = 1 + offered.findIndex((each) => each.severity === fault.severity);
    enable(severity, offered.length > 1);
    enable(seed, !setup.states);
    enable(line.querySelector("button"), has({ ...state, ...without(state, index) }, setup));
    showKinds(kind, state, setup, index);
    const described = setup.kinds.find((each) => each.name === fault.kind).levels[fault.severity - 1];
    level.textContent = `severity ${fault.severity}: ${described}`;
    severity.setAttribute("aria-valuetext", level.textContent);
  });
  enable(at("add-fault"), state.faults.length < setup.limits.faults && added(state, setup) !== undefined);
}

function showKinds(select, state, setup, index) {
  const taken = new Set(state.faults.map((each) => each.kind));
  for (const each of select.options) {
    const isOwn = each.value === state.faults[index].kind;
    each.disabled = !isOwn && (taken.has(each.value) || !replaced(state, setup, index, each.value));
  }
}

function faultLine(state, setup, index, changed) {
  const line = document.createElement("li");
  const top = document.createElement("div");
  const below = document.createElement("div");
  top.className = below.className = "line";
  const kind = document.createElement("select");
  kind.setAttribute("aria-label", "Kind of fault");
  kind.replaceChildren(...setup.kinds.map(({ name }) => option(name, name.replaceAll("_", " "))));
  kind.addEventListener("change", () => apply(state, replaced(state, setup, index, kind.value), changed));
  const severity = input("range", "Severity");
  severity.addEventListener("input", () =>
    apply(state, severities(state, setup, index)[Number(severity.value) - 1].change, changed));
  const seed = input("number", "Seed", { min: 0, max: setup.limits.seed, step: 1 });
  seed.addEventListener("change", () => {
    const value = Math.max(0, Math.min(setup.limits.seed, Math.round(Number(seed.value) || 0)));
    set(state.faults[index], "seed", value, () => changed(true));
  });
  top.append(kind, button("\u2715", () => {
    apply(state, without(state, index), changed);
    at("add-fault").focus();
  }, "Remove this fault"));
  const named = document.createElement("label");
  named.append("seed ", seed);
  below.append(severity, named);
  line.append(top, below, document.createElement("small"));
  return line;
}

function set(place, name, value, changed) {
  place[name] = value;
  changed(false);
}

function input(type, label, settings = {}) {
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
