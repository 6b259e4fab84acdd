// The camera's image with boxes, labels and gates on a canvas.

import { EDGES, boxOf, corners, iou, project } from "./geometry.js";

const WIDTH = 1242; // pixels of the canvas, whatever the camera's

export function drawImage(canvas, scene, side) {
  const [height, width] = scene.image_size_px;
  const scale = WIDTH / width;
  canvas.width = WIDTH;
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext("2d");
  pen.drawImage(scene.image, 0, 0, canvas.width, canvas.height);
  if (!scene.sensors.camera) write(pen, "the camera delivered nothing", 20, 40, "#fff");
  if (side.gate) drawGate(pen, side.gate, canvas);
  pen.lineJoin = "round";
  if (side.view.labels) drawLabels(pen, scene, scale);
  const taken = [];
  for (const { object, id } of side.objects) {
    const color = `rgb(${(side.colors[object.class] ?? [235, 235, 235]).join(",")})`;
    const isSelected = id === side.selected;
    const isFaded = side.selected !== null && !isSelected;
    pen.globalAlpha = isFaded ? 0.45 : 1;
    const box = boxOf(object);
    if (side.view.projected && box) wire(pen, scene, box, color, scale, isSelected ? 3 : 1.5);
    const text = side.view.boxes2d && object.box_px && frame(pen, object, color, scale, isSelected);
    pen.globalAlpha = 1;
    if (text && !isFaded) name(pen, text, isSelected, taken);
  }
}

// A 2D box; its text and place are returned.
function frame(pen, object, color, scale, isSelected) {
  const [left, top, right, bottom] = object.box_px.map((each) => each * scale);
  outlined(pen, color, isSelected ? 4 : 2.5, () => pen.rect(left, top, right - left, bottom - top));
  return { color, left, top, words: `${object.class} ${object.score.toFixed(2)}` };
}

// The text of a 2D box; left out where a surer object's stands.
function name(pen, { color, left, top, words }, isSelected, taken) {
  const place = [left, top - 20, left + 110, top];
  if (!isSelected && taken.some((each) => iou(each, place) > 0)) return;
  taken.push(place);
  write(pen, words, left, top - 5, color);
}

function wire(pen, scene, box, color, scale, width) {
  const pixels = corners(box).map((each) => project(scene.image_from_lidar, each));
  if (pixels.some((each) => each === null)) return;
  outlined(pen, color, width, () => {
    for (const [a, b] of EDGES) {
      pen.moveTo(pixels[a][0] * scale, pixels[a][1] * scale);
      pen.lineTo(pixels[b][0] * scale, pixels[b][1] * scale);
    }
  });
}

function drawLabels(pen, scene, scale) {
  pen.setLineDash([6, 4]);
  for (const label of scene.labels ?? []) {
    if (label.class === "DontCare") continue;
    const [left, top, right, bottom] = label.box_px.map((each) => each * scale);
    outlined(pen, "#fff", 1.5, () => pen.rect(left, top, right - left, bottom - top));
  }
  pen.setLineDash([]);
}

// A line with a dark rim, to be seen on any picture.
function outlined(pen, color, width, trace) {
  for (const [style, extra] of [["rgba(0,0,0,0.7)", 2], [color, 0]]) {
    pen.beginPath();
    trace();
    pen.strokeStyle = style;
    pen.lineWidth = width + extra;
    pen.stroke();
  }
}

function write(pen, text, left, bottom, color) {
  pen.font = "600 15px system-ui, 'DejaVu Sans', sans-serif";
  const top = Math.max(bottom, 18);
  const width = pen.measureText(text).width;
  const start = Math.max(0, Math.min(left, WIDTH - width - 8));
  pen.fillStyle = "rgba(0,0,0,0.75)";
  pen.fillRect(start, top - 15, width + 8, 19);
  pen.fillStyle = color;
  pen.fillText(text, start + 4, top);
}

// Where a sensor's features are used: orange; where not: dark.
function drawGate(pen, gate, canvas) {
  const [rows, columns] = [gate.length, gate[0].length];
  const cells = new ImageData(columns, rows);
  gate.flat().forEach((value, index) => {
    cells.data.set([230, 159, 0, Math.round(1.7 * value)], 4 * index);
    if (value < 50) cells.data.set([10, 20, 60, Math.round(3 * (50 - value))], 4 * index);
  });
  const small = new OffscreenCanvas(columns, rows);
  small.getContext("2d").putImageData(cells, 0, 0);
  pen.drawImage(small, 0, 0, canvas.width, canvas.height);
}
