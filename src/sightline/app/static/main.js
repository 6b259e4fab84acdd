// The page: asks for the state's answers and shows them in all views.

import * as server from "./api.js";
import { Cloud, boxesOf, modeOf } from "./cloud.js";
import * as controls from "./controls.js";
import { Drive, healthLines } from "./drive.js";
import { saveLine, savePicture } from "./exporting.js";
import * as files from "./files.js";
import { boxOf } from "./geometry.js";
import { drawImage } from "./image.js";
import { fillTable, found, pairUp } from "./objects.js";
import {
  COLOURS, GATES, SIDES, asked, brokenBy, clean, has, isBroken, parse, permalink, refused,
} from "./state.js";

const AGAIN_MS = 2000;
const source = document.documentElement.dataset.source === "files" ? files : server;
const at = (id) => document.getElementById(id);
const sides = { clean: { parts: {} }, broken: { parts: {} } };
const running = {};
const used = new Set(); // weights that gave answers already
let setup, state, cloud, drive;
let rows = [];
let isPlaying = false;

async function start() {
  setup = await source.setup();
  state = parse(location.search, setup);
  const wrong = refused(location.search, state, setup);
  const isKnown = has(state, setup);
  if (!isKnown) Object.assign(state, { faults: [], yaw: 0 });
  at("data-name").textContent = setup.data;
  cloud = new Cloud(at("cloud"), setup.scales.depth.colors, (camera) => {
    state.view.camera = camera.map((each) => Number(each.toFixed(3)));
    keepLink();
  });
  if (!cloud.gl) warn("this browser shows no WebGL 2: there are no points; the rest works");
  if (state.view.camera) cloud.camera = [...state.view.camera];
  drive = new Drive(at("timeline"), setup.timeline, setup.scales.depth.colors);
  controls.connect(state, setup, changed);
  connectButtons();
  changed(true);
  if (!isKnown) warn("the state of this link was not computed when the page was exported");
  else if (wrong.length) warn(`left out of this link, as this page does not know it: ${wrong.join(", ")}`);
}

function changed(isAsked) {
  controls.show(state, setup, changed);
  keepLink();
  if (isAsked) ask();
  render();
}

function keepLink() {
  history.replaceState(null, "", `?${permalink(state, setup)}`);
}

// Asks for both sides; the clean one only if it is another state than the last one asked for.
function ask() {
  warn("");
  drive.under(asked({ ...state, frame: "" }, setup));
  askSide("broken", asked(state, setup));
  const sound = asked(clean(state), setup);
  if (isBroken(state)) askSide("clean", sound);
  else running.clean?.abort.abort();
}

async function askSide(name, query) {
  if (running[name]?.query === query) return;
  running[name]?.abort.abort();
  const mine = { query, abort: new AbortController(), since: performance.now() };
  running[name] = mine;
  const side = sides[name];
  side.parts = {};
  side.query = query;
  if (name === "broken") {
    document.body.dataset.busy = "true";
    status(mine, null);
    showCommands(query, mine.abort.signal);
  }
  const isNewest = () => running[name] === mine;  // an answer may come while it is cancelled
  try {
    const picture = source.scene(query, mine.abort.signal).then((scene) => {
      if (!isNewest()) return;
      side.scene = scene;
      cloud.load(name, scene);
      if (name === "broken") status(mine, "picture");
      render();
    });
    await Promise.all([picture, source.answers(query, name, mine.abort.signal,
      (event, content) => hear(name, mine, event, content))]);
    if (name === "broken" && isNewest()) settle(mine);
  } catch (error) {
    if (mine.abort.signal.aborted || !isNewest()) return;
    running[name] = undefined;
    mine.abort.abort();
    warn(error.message);
    if (name === "broken") settle(null);
    if (error instanceof source.GoneError) askAgain();
  }
}

// Asks until the server is there again; a change of the state asks by itself.
function askAgain() {
  clearTimeout(running.again);
  running.again = setTimeout(() => source.setup().then(ask, askAgain), AGAIN_MS);
}

function hear(name, mine, event, content) {
  if (running[name] !== mine) return;
  if (event === "part") {
    sides[name].parts[content.part] = content;
    if (name === "broken") {
      status(mine, content.part);
      if (content.part === "health") remember(content);
    }
    render();
  } else if (event === "fault") warn(content.reason);
  else if (event === "notice") warn(content);
}

// Progress of the answers: the last part; null: none came yet.
function status(mine, part) {
  const last = part ? `; ${part} came after ${Math.round(performance.now() - mine.since)} ms` : "";
  const first = used.has(weightsKey()) ? "" : " (networks used for the first time: up to some minutes)";
  at("status").textContent = `computing${first}${last}`;
}

function weightsKey() {
  return JSON.stringify(state.weights);
}

function settle(mine) {
  if (mine) {
    document.body.dataset.ms = Math.round(performance.now() - mine.since);
    at("status").textContent = `all results: ${document.body.dataset.ms} ms`;
    used.add(weightsKey());
  }
  document.body.dataset.busy = "false";
  if (isPlaying) setTimeout(playOn, 60);
}

function remember(health) {
  const scores = Object.fromEntries(["camera", "lidar", "alignment"].map((each) =>
    [each, health[each]?.score ?? null]));
  if (drive.judged.has(state.frame)) return;
  drive.add(state.frame, scores, Object.keys(scores).filter((each) => scores[each] !== null && scores[each] < 0.01));
}

// What is shown of a side: without faults both are the same.
function shownSide(name) {
  return name === "clean" && !isBroken(state) ? sides.broken : sides[name];
}

function render() {
  const view = state.view;
  document.body.dataset.compare = isBroken(state) ? view.compare : "broken";
  const score = view.score;
  const broken = found(sides.broken.parts, score);
  const sound = isBroken(state) ? found(sides.clean.parts, score) : broken;
  rows = pairUp(sound, broken);
  if (view.selected && !rows.some((each) => each.id === view.selected) && sound && broken) {
    view.selected = null;
  }
  for (const name of ["clean", "broken"]) renderSide(name);
  renderCloud();
  fillTable(at("objects"), rows, view.selected, setup.colors, select);
  const lost = rows.filter((each) => each.state === "lost").length;
  const kept = rows.filter((each) => each.state === "kept").length;
  at("objects-note").textContent = sound && broken && isBroken(state)
    ? `${kept} of ${kept + lost} kept` : broken ? `${broken.length} found` : "...";
  healthLines(at("health"), sides.broken.parts, setup.checks);
  renderDrive();
}

function renderSide(name) {
  const side = shownSide(name);
  const { view } = state;
  if (side.scene) {
    const objects = rows.filter((each) => each[name]).map((each) => ({ id: each.id, object: each[name] }));
    const gate = view.gates === "none" ? null : side.parts.detection2d?.[`${view.gates}_gate`];
    drawImage(at(`image-${name}`), side.scene, {
      objects, view, gate, selected: view.selected, colors: setup.colors,
    });
  }
  const picture = at(`depth-${name}`);
  const part = side.parts["depth-completion"];
  const address = part?.files?.includes(view.depth) ? source.picture(view.depth, side.query) : null;
  if (address && picture.getAttribute("src") !== address) picture.src = address;
  if (address) picture.hidden = false;
  else if (part) picture.hidden = true;
  if (name !== "broken" || !side.scene) return;
  const { sensors } = side.scene;
  at("image-note").textContent = !sensors.camera ? "the camera delivered nothing"
    : view.gates === "none" ? "" : `orange: the ${view.gates}'s features are used; dark: they are not`;
  at("cloud-note").textContent = sensors.lidar
    ? `${side.scene.num_points.toLocaleString("en")} points` : "the LiDAR delivered nothing";
  at("depth-note").textContent = depthNote(part, view.depth);
  drawScale(at("depth-scale"), setup.scales[view.depth]);
}

function depthNote(part, kind) {
  if (!part) return "...";
  if (part.by === "none") return "left out";
  if (part.lacks) return `${part.by} cannot work without ${part.lacks.join(" and ")}`;
  if (!part.files.includes(kind)) return `${part.by} gives none`;
  const share = (key) => Math.round(100 * part.depth[key]);
  const guessed = part.depth.guessed_share ? `, darker: guessed from the image, ${share("guessed_share")} %` : "";
  return `${part.by}, values for ${share("valid_share")} % of the image${guessed}`;
}

function renderCloud() {
  const { view } = state;
  const names = document.body.dataset.compare === "both" ? ["clean", "broken"] : [document.body.dataset.compare];
  const chosen = rows.find((each) => each.id === view.selected);
  const box = chosen && boxOf(chosen.broken ?? chosen.clean);
  if (view.follow && box) cloud.look(box.slice(0, 3));
  cloud.show(names.map((side) => ({
    side: side === "clean" && !isBroken(state) ? "broken" : side,
    boxes: boxesOf(rows, setup.colors, view.selected, side).concat(labelBoxes(side)),
  })), { mode: modeOf(view.colour), isLight: isLight() });
}

function labelBoxes(name) {
  if (!state.view.labels) return [];
  const color = isLight() ? [0, 0, 0] : [1, 1, 1];
  return (shownSide(name).scene?.labels ?? []).filter((each) => each.box_3d && each.class !== "DontCare")
    .map((each) => ({ box: each.box_3d, color, isThick: false }));
}

function renderDrive() {
  const index = setup.timeline.indexOf(state.frame);
  at("time").max = setup.timeline.length - 1;
  if (index >= 0) at("time").value = index;
  at("time").setAttribute("aria-valuetext", state.frame);
  const seconds = sides.broken.scene?.timestamp_s;
  at("time-note").textContent = `frame ${state.frame}, ${setup.frames.indexOf(state.frame) + 1} of ${setup.frames.length}`
    + (seconds === null || seconds === undefined ? "" : `, ${seconds.toFixed(2)} s`);
  drive.draw(state.frame);
}

function drawScale(canvas, scale) {
  const width = canvas.clientWidth;
  Object.assign(canvas, { width, height: 34 });
  const pen = canvas.getContext("2d");
  const fill = pen.createLinearGradient(0, 0, width, 0);
  scale.colors.forEach((each, index) => fill.addColorStop(index / (scale.colors.length - 1), `rgb(${each})`));
  pen.fillStyle = fill;
  pen.fillRect(0, 0, width, 10);
  pen.fillStyle = getComputedStyle(document.body).color;
  pen.font = "12px system-ui, sans-serif";
  scale.marks.forEach(([metres, share]) => {
    pen.textAlign = share < 0.05 ? "left" : share > 0.95 ? "right" : "center";
    pen.fillText(`${metres} m`, share * width, 26);
  });
}

function select(id) {
  state.view.selected = id;
  changed(false);
}

async function showCommands(query, signal) {
  try {
    at("commands").textContent = await source.commands(query, signal);
  } catch (error) {
    if (!signal.aborted) warn(error.message);
  }
}

function warn(text) {
  at("notice").textContent = text;
  at("notice").hidden = !text;
}

function isLight() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "light" : matchMedia("(prefers-color-scheme: light)").matches;
}

function showTheme() {
  if (state.view.theme) document.documentElement.dataset.theme = state.view.theme;
  at("theme").textContent = isLight() ? "Dark" : "Light";
  at("theme").setAttribute("aria-pressed", String(isLight()));
}

function playOn() {
  const index = setup.timeline.indexOf(state.frame);
  const next = setup.timeline[index + 1];
  if (!isPlaying || index < 0 || next === undefined) return play(false);
  state.frame = next;
  changed(true);
}

function play(isOn) {
  isPlaying = isOn;
  at("play").setAttribute("aria-pressed", String(isOn));
  at("play").textContent = isOn ? "Pause" : "Play";
  if (isOn && state.frame === setup.timeline.at(-1)) state.frame = setup.timeline[0];
  if (isOn) document.body.dataset.busy === "true" ? changed(true) : playOn();
}

async function judge() {
  running.timeline?.abort();
  const abort = running.timeline = new AbortController();
  drive.judged.clear();
  try {
    await source.timeline(asked(state, setup), abort.signal, (event, content) => {
      if (event === "frame") drive.add(content.frame, content.scores, content.alarms);
      else if (event === "fault") warn(content.reason);
      drive.draw(state.frame);
    });
  } catch (error) {
    if (!abort.signal.aborted) warn(error.message);
  }
}

async function copy(text, button) {
  const before = button.textContent;
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = "Copied";
  } catch {
    button.textContent = "Copy it from the address";
  }
  setTimeout(() => { button.textContent = before; }, 1500);
}

function cycle(place, name, offered) {
  place[name] = offered[(offered.indexOf(place[name]) + 1) % offered.length];
  changed(false);
}

function onKey(event) {
  const isTyping = event.target.closest?.("input, select, textarea");
  if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
  const { view } = state;
  const acts = {
    ",": () => controls.step(state, setup, -1, changed),
    ".": () => controls.step(state, setup, 1, changed),
    p: () => play(!isPlaying),
    c: () => cycle(view, "compare", SIDES),
    g: () => cycle(view, "gates", GATES),
    l: () => { view.labels = !view.labels; changed(false); },
    n: () => select(rows[(rows.findIndex((each) => each.id === view.selected) + 1) % rows.length]?.id ?? null),
    Escape: () => select(null),
  };
  const colour = COLOURS[Number(event.key) - 1];
  if (colour) { view.colour = colour; changed(false); } else acts[event.key]?.();
}

// The views with their captions.
function captioned() {
  const broken = isBroken(state) ? `broken by ${brokenBy(state)}` : "clean";
  const points = { both: `clean, ${broken}`, clean: "clean", broken }[document.body.dataset.compare];
  return [
    ["image-clean", `${state.frame}: clean`], ["image-broken", `${state.frame}: ${broken}`],
    ["cloud", `Points: ${points}`], ["depth-clean", `${depthName()}: clean`],
    ["depth-broken", `${depthName()}: ${broken}`],
  ].map(([id, caption]) => [at(id), caption]);
}

function depthName() {
  const marks = setup.scales[state.view.depth].marks;
  const name = state.view.depth === "depth" ? "Depth" : "Expected error of depth";
  return `${name}, ${marks[0][0]} to ${marks.at(-1)[0]} m`;
}

function connectButtons() {
  const name = () => `sightline-${state.frame.replaceAll(/[^\w-]/g, "_")}`;
  at("copy-link").addEventListener("click", () => copy(location.href, at("copy-link")));
  at("copy-commands").addEventListener("click", () => copy(at("commands").textContent, at("copy-commands")));
  at("save-png").addEventListener("click", () => savePicture(name(), captioned()));
  at("save-json").addEventListener("click", () => {
    const { scene, parts } = sides.broken;
    if (scene) saveLine(name(), state, location.href, scene, parts);
  });
  at("theme").addEventListener("click", () => {
    state.view.theme = isLight() ? "dark" : "light";
    showTheme();
    changed(false);
  });
  at("play").addEventListener("click", () => play(!isPlaying));
  at("judge").addEventListener("click", judge);
  at("time").addEventListener("input", (event) => {
    state.frame = setup.timeline[Number(event.target.value)];
    changed(true);
  });
  at("timeline").addEventListener("click", (event) => {
    state.frame = drive.frameAt(event.offsetX);
    changed(true);
  });
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => { showTheme(); render(); });
  document.addEventListener("keydown", onKey);
  addEventListener("resize", render);
  showTheme();
}

start().catch((error) => warn(error.message));
