// Points and boxes in space by WebGL: turned, moved and zoomed by mouse, finger and keys.

import { EDGES, boxOf, corners, lookAt, multiply, perspective } from "./geometry.js";
import { COLOURS } from "./state.js";

const FIRST = [Math.PI, 0.36, 25, 13, 0, -0.5]; // azimuth, elevation [rad], distance, target [m]
const POINTS = `#version 300 es
in vec3 steps; in float reflectance; in float fault;
uniform mat4 clip; uniform mat4 pixel; uniform float metres; uniform float size;
uniform int mode; uniform vec2 imageSize; uniform sampler2D ramp; uniform sampler2D image;
uniform vec3 missing;
out vec3 colour;
vec3 on(float share) { return texture(ramp, vec2(clamp(share, 0.0, 1.0), 0.5)).rgb; }
void main() {
  vec3 place = steps * metres;
  gl_Position = clip * vec4(place, 1.0);
  gl_PointSize = size * clamp(30.0 / gl_Position.w, 1.0, 3.0);
  if (mode == 0) colour = on((place.z + 2.5) / 4.5);
  else if (mode == 1) colour = on(log(max(length(place), 2.0) / 2.0) / log(40.0));
  else if (mode == 2) colour = on(sqrt(reflectance));
  else if (mode == 4) colour = fault > 0.5 ? vec3(0.90, 0.45, 0.0) : missing;
  else {
    vec4 seen = pixel * vec4(place, 1.0);
    vec2 at = seen.xy / seen.z / imageSize;
    bool inside = seen.z > 0.0 && all(greaterThan(at, vec2(0.0))) && all(lessThan(at, vec2(1.0)));
    colour = inside ? texture(image, at).rgb : missing;
  }
}`;
const DOT = `#version 300 es
precision mediump float; in vec3 colour; out vec4 shown;
void main() { shown = vec4(colour, 1.0); }`;
const LINES = `#version 300 es
in vec3 place; in vec3 tint; uniform mat4 clip; out vec3 colour;
void main() { gl_Position = clip * vec4(place, 1.0); colour = tint; }`;

export class Cloud {
  constructor(canvas, rampColors, moved) {
    this.canvas = canvas;
    this.moved = moved;
    this.camera = [...FIRST];
    this.sides = [];
    this.view = { mode: 0, isLight: false };
    this.shown = null; // all that the last picture was drawn from, but scenes
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    this.gl = gl;
    if (!gl) return;
    this.points = program(gl, POINTS, DOT);
    this.lines = program(gl, LINES, DOT);
    this.lineBuffer = gl.createBuffer();
    this.ramp = texture(gl);
    const bytes = new Uint8Array([...rampColors].reverse().flatMap((each) => [...each, 255]));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, rampColors.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    this.scenes = {};
    listen(this);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Takes the points and the image of a side, "clean" or "broken".
  load(side, scene) {
    const gl = this.gl;
    if (!gl) return;
    const kept = this.scenes[side] ?? { buffer: gl.createBuffer(), image: texture(gl) };
    gl.bindBuffer(gl.ARRAY_BUFFER, kept.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, scene.cloud.bytes, gl.STATIC_DRAW);
    gl.bindTexture(gl.TEXTURE_2D, kept.image);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, scene.image);
    const [a, b, c] = scene.image_from_lidar;
    const pixel = new Float32Array([0, 1, 2, 3].flatMap((k) => [a[k], b[k], c[k], k === 3 ? 1 : 0]));
    const [height, width] = scene.image_size_px;
    const { count, step } = scene.cloud;
    this.scenes[side] = { ...kept, count, step, pixel, size: [width, height] };
    this.shown = null;
  }

  // Shows sides from left to right, each with its boxes: {side, boxes: [{box, color, width}]}.
  // Draws only what has changed: in software a picture takes a tenth of a second.
  show(sides, view) {
    const wanted = JSON.stringify([sides, view, this.camera]);
    if (wanted === this.shown) return;
    this.sides = sides;
    this.view = view;
    this.draw();
    this.shown = wanted;
  }

  reset() {
    this.camera = [...FIRST];
    this.changed();
  }

  look(target) {
    this.camera = [...this.camera.slice(0, 3), ...target];
  }

  changed() {
    this.draw();
    this.moved(this.camera);
  }

  draw() {
    const { gl, canvas } = this;
    if (!gl || !canvas.clientWidth) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((each) => Math.round(each * ratio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const back = this.view.isLight ? [0.97, 0.98, 0.98] : [0.043, 0.059, 0.071];
    gl.clearColor(...back, 1);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const share = Math.floor(width / Math.max(this.sides.length, 1));
    this.sides.forEach((side, index) => {
      gl.viewport(index * share, 0, share, height);
      const clip = this.clip(share / height);
      if (this.scenes[side.side]?.count) this.drawPoints(this.scenes[side.side], clip, ratio);
      this.drawLines(side.boxes, clip);
    });
  }

  clip(aspect) {
    const [azimuth, elevation, far, x, y, z] = this.camera;
    const flat = far * Math.cos(elevation);
    const eye = [x + flat * Math.cos(azimuth), y + flat * Math.sin(azimuth), z + far * Math.sin(elevation)];
    return multiply(perspective(0.9, aspect, 0.3, 600), lookAt(eye, [x, y, z]));
  }

  drawPoints(scene, clip, ratio) {
    const { gl, points } = this;
    gl.useProgram(points.program);
    gl.bindBuffer(gl.ARRAY_BUFFER, scene.buffer);
    attribute(gl, points, "steps", 3, gl.SHORT, false, 8, 0);
    attribute(gl, points, "reflectance", 1, gl.UNSIGNED_BYTE, true, 8, 6);
    attribute(gl, points, "fault", 1, gl.UNSIGNED_BYTE, false, 8, 7);
    gl.uniformMatrix4fv(points.uniform("clip"), false, clip);
    gl.uniformMatrix4fv(points.uniform("pixel"), false, scene.pixel);
    gl.uniform1f(points.uniform("metres"), scene.step);
    gl.uniform1f(points.uniform("size"), 1.3 * ratio);
    gl.uniform1i(points.uniform("mode"), this.view.mode);
    gl.uniform2fv(points.uniform("imageSize"), scene.size);
    gl.uniform3fv(points.uniform("missing"), this.view.isLight ? [0.45, 0.5, 0.55] : [0.5, 0.56, 0.6]);
    [this.ramp, scene.image].forEach((each, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, each);
    });
    gl.uniform1i(points.uniform("ramp"), 0);
    gl.uniform1i(points.uniform("image"), 1);
    gl.drawArrays(gl.POINTS, 0, scene.count);
    gl.activeTexture(gl.TEXTURE0);
  }

  drawLines(boxes, clip) {
    const { gl, lines } = this;
    const shade = this.view.isLight ? 0.7 : 1; // to be seen on white
    const rows = boxes.flatMap(({ box, color, isThick }) => edges(box, color.map((each) => each * shade), isThick));
    rows.push(...ring(this.view.isLight));
    gl.useProgram(lines.program);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(rows), gl.STREAM_DRAW);
    attribute(gl, lines, "place", 3, gl.FLOAT, false, 24, 0);
    attribute(gl, lines, "tint", 3, gl.FLOAT, false, 24, 12);
    gl.uniformMatrix4fv(lines.uniform("clip"), false, clip);
    gl.drawArrays(gl.LINES, 0, rows.length / 6);
  }
}

export function boxesOf(rows, colors, selected, side) {
  return rows.flatMap((row) => {
    const object = row[side];
    const box = object && boxOf(object);
    if (!box) return [];
    const color = (colors[object.class] ?? [235, 235, 235]).map((each) => each / 255);
    return [{ box, color, isThick: row.id === selected }];
  });
}

export function modeOf(colour) {
  return COLOURS.indexOf(colour);
}

// Lines of a box; a selected one is drawn thrice, as lines are one pixel wide.
function edges(box, color, isThick) {
  const grown = isThick ? [0, 0.05, 0.1, 0.15] : [0];
  return grown.flatMap((extra) => {
    const larger = [...box.slice(0, 3), ...box.slice(3, 6).map((each) => each + extra), box[6]];
    const at = corners(larger);
    return EDGES.flatMap(([a, b]) => [...at[a], ...color, ...at[b], ...color]);
  });
}

// Where the car stands, and what is ahead: a cross at the LiDAR with an arrow of three metres.
function ring(isLight) {
  const color = isLight ? [0.1, 0.15, 0.2] : [0.9, 0.93, 0.95];
  const ends = [[0, -0.8], [0, 0.8], [-0.8, 0], [3, 0], [3, 0], [2.4, 0.4], [3, 0], [2.4, -0.4]];
  return ends.flatMap(([x, y]) => [x, y, -1.7, ...color]);
}

function attribute(gl, { program: of }, name, size, type, normalised, stride, offset) {
  const place = gl.getAttribLocation(of, name);
  if (place < 0) return;
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, size, type, normalised, stride, offset);
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return { program: made, uniform: (name) => gl.getUniformLocation(made, name) };
}

function texture(gl) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
  return made;
}

function listen(cloud) {
  const { canvas } = cloud;
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const by = [event.clientX - before[0], event.clientY - before[1]];
    const apart = spread(fingers);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 2) zoom(cloud, apart / (spread(fingers) || 1));
    else if (event.shiftKey || event.buttons === 2) move(cloud, ...by);
    else turn(cloud, ...by);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(cloud, Math.exp(event.deltaY / 600));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const arrows = { ArrowLeft: [-30, 0], ArrowRight: [30, 0], ArrowUp: [0, -30], ArrowDown: [0, 30] };
    if (arrows[event.key]) (event.shiftKey ? move : turn)(cloud, ...arrows[event.key]);
    else if (event.key === "+" || event.key === "=") zoom(cloud, 0.85);
    else if (event.key === "-") zoom(cloud, 1.18);
    else if (event.key === "0") cloud.reset();
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
}

function turn(cloud, right, down) {
  cloud.camera[0] -= right / 200;
  cloud.camera[1] = Math.max(-0.1, Math.min(1.55, cloud.camera[1] + down / 200));
  cloud.changed();
}

function move(cloud, right, down) {
  const [azimuth, , far] = cloud.camera;
  const step = far / 700;
  cloud.camera[3] += step * (right * Math.sin(azimuth) - down * Math.cos(azimuth));
  cloud.camera[4] += step * (-right * Math.cos(azimuth) - down * Math.sin(azimuth));
  cloud.changed();
}

function zoom(cloud, factor) {
  cloud.camera[2] = Math.max(3, Math.min(200, cloud.camera[2] * factor));
  cloud.changed();
}

function spread(fingers) {
  const [a, b] = [...fingers.values()];
  return b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 0;
}
