// Answers of an exported page: files that were computed beforehand, instead of a server's.

import { unpack } from "./points.js";

const MOST_KEPT = 24;
const kept = new Map(); // answers by state, the last used of them
const places = new Map(); // pictures of each state that was answered
let offered;

export class GoneError extends Error {
  constructor(path) {
    super(`${path} cannot be loaded; the page goes on when its files are there again`);
  }
}

export async function setup() {
  offered = await json("setup.json");
  return offered;
}

export async function scene(query, signal) {
  const { scene: content, files } = await answerOf(query);
  const [image, cloud] = await Promise.all([
    got(files.image, (each) => each.blob().then((bytes) => createImageBitmap(bytes))),
    got(files.points, (each) => each.arrayBuffer().then(unzipped).then(unpack)),
  ]);
  signal.throwIfAborted();
  return { ...content, image, cloud };
}

export async function answers(query, name, signal, hear) {
  const { parts } = await answerOf(query);
  signal.throwIfAborted();
  for (const part of parts) hear("part", part);
}

export async function timeline(query, signal, hear) {
  const lines = await json("timelines.json");
  signal.throwIfAborted();
  const rest = new URLSearchParams(query);
  rest.delete("frame");
  for (const [name, content] of lines[keyOf(rest)] ?? []) hear(name, content);
}

export async function commands(query, signal) {
  const { commands: text } = await answerOf(query);
  signal.throwIfAborted();
  return text;
}

// Address of a picture of a state, which has been answered before.
export function picture(name, query) {
  return places.get(keyOf(query))[name];
}

// Key of a state in the list of those that were computed.
export function keyOf(query) {
  return [...new URLSearchParams(query)].map(([name, value]) => `${name}=${value}`).join("&");
}

async function answerOf(query) {
  const key = keyOf(query);
  if (!(key in offered.states)) throw new Error("this state was not computed when the page was exported");
  const answer = kept.get(key) ?? await json(offered.states[key]);
  kept.delete(key);
  kept.set(key, answer);
  places.set(key, answer.files);
  if (kept.size > MOST_KEPT) kept.delete(kept.keys().next().value);
  return answer;
}

function json(path) {
  return got(path, (response) => response.json());
}

// A file that is half there, as while it is copied to the server, is as good as none.
async function got(path, convert) {
  const response = await fetch(path).catch(() => null);
  if (!response?.ok) throw new GoneError(path);
  return convert(response).catch(() => { throw new GoneError(path); });
}

// Some servers unpack files on the way, so that the first bytes tell.
async function unzipped(buffer) {
  const [first, second] = new Uint8Array(buffer, 0, 2);
  if (first !== 0x1f || second !== 0x8b) return buffer;
  const stream = new Blob([buffer]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}
