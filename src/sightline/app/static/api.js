// Requests to the server, each of which a newer one cancels.

const TAB = Math.random().toString(36).slice(2, 10);
let turn = 0; // requests may overtake each other on their way
const PICTURES = ["image", "points"];

export async function json(path, signal) {
  const response = await fetch(path, { signal });
  if (!response.ok) throw new Error(await reason(response));
  return response.json();
}

// The scene of a state with its image and points.
export async function scene(query, signal) {
  const files = PICTURES.map(async (name) => {
    const response = await fetch(`api/file/${name}?${query}`, { signal });
    if (!response.ok) throw new Error(await reason(response));
    return response;
  });
  const [content, image, points] = await Promise.all([
    json(`api/scene?${query}`, signal),
    files[0].then((each) => each.blob()).then((each) => createImageBitmap(each)),
    files[1].then((each) => each.arrayBuffer()),
  ]);
  return { ...content, image, cloud: unpack(points) };
}

// Server-sent events of a path, until its end: calls `hear(name, content)`.
export async function events(path, query, name, signal, hear) {
  const response = await fetch(`api/${path}?${query}&client=${TAB}-${name}&turn=${turn += 1}`, { signal });
  if (!response.ok) throw new Error(await reason(response));
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const [event, data] = block.split("\n");
      hear(event.slice("event: ".length), JSON.parse(data.slice("data: ".length)));
    }
  }
}

// Points as the server packs them: count, step, then x, y, z (int16), reflectance, fault.
function unpack(buffer) {
  const header = new DataView(buffer);
  return {
    count: header.getUint32(0, true),
    step: header.getFloat32(4, true),
    bytes: new Uint8Array(buffer, 8),
  };
}

async function reason(response) {
  const text = await response.text();
  try {
    return JSON.parse(text).reason;
  } catch {
    return text.trim() || `the server answered ${response.status}`;
  }
}
