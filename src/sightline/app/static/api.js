// Answers of the server; a newer request cancels the older.

import { unpack } from "./points.js";

const TAB = Math.random().toString(36).slice(2, 10);
let turn = 0; // requests may overtake each other on their way
const PICTURES = ["image", "points"];

export class GoneError extends Error {
  constructor() {
    super("the server does not answer; the page goes on when it is started again");
  }
}

export const setup = () => json("api/setup");

export const answers = (query, name, signal, hear) => events("answers", query, name, signal, hear);

export const timeline = (query, signal, hear) => events("timeline", query, "timeline", signal, hear);

export async function commands(query, signal) {
  return (await json(`api/commands?${query}`, signal)).commands;
}

// Address of a picture of a state.
export const picture = (name, query) => `api/file/${name}?${query}`;

// The scene of a state with its image and points.
export async function scene(query, signal) {
  const files = PICTURES.map((name) => got(picture(name, query), signal));
  const [content, image, points] = await Promise.all([
    json(`api/scene?${query}`, signal),
    files[0].then((each) => each.blob()).then((each) => createImageBitmap(each)),
    files[1].then((each) => each.arrayBuffer()),
  ]);
  return { ...content, image, cloud: unpack(points) };
}

// Server-sent events of a path, until its end: calls `hear(name, content)`.
async function events(path, query, name, signal, hear) {
  const response = await got(`api/${path}?${query}&client=${TAB}-${name}&turn=${turn += 1}`, signal);
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read().catch(() => ({ done: true }));
    if (done) {
      signal.throwIfAborted();
      throw new GoneError();
    }
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const [event, data] = block.split("\n");
      const kind = event.slice("event: ".length);
      if (kind === "done" || kind === "cancelled") return;
      hear(kind, JSON.parse(data.slice("data: ".length)));
    }
  }
}

async function json(path, signal) {
  return (await got(path, signal)).json();
}

async function got(path, signal) {
  const response = await fetch(path, { signal }).catch(() => {
    signal?.throwIfAborted();
    throw new GoneError();
  });
  if (!response.ok) throw new Error(await reason(response));
  return response;
}

async function reason(response) {
  const text = await response.text();
  try {
    return JSON.parse(text).reason;
  } catch {
    return text.trim() || `the server answered ${response.status}`;
  }
}
