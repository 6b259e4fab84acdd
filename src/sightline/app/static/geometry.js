// Matrices (column-major, as WebGL has them), boxes and overlaps.

export const EDGES = [
  [0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7],
  [1, 6], [2, 5], // a cross on the front
];

export function multiply(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      for (let k = 0; k < 4; k += 1) out[4 * column + row] += a[4 * k + row] * b[4 * column + k];
    }
  }
  return out;
}

export function perspective(fovRad, aspect, near, far) {
  const f = 1 / Math.tan(fovRad / 2);
  return new Float32Array([
    f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
    0, 0, (2 * far * near) / (near - far), 0,
  ]);
}

export function lookAt(eye, target) {
  const back = unit(minus(eye, target));
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  return new Float32Array([
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
  ]);
}

// Corners of a box [x, y, z, length, width, height, yaw]; 1, 2, 5, 6 are in front.
export function corners([x, y, z, length, width, height, yaw]) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  const signs = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
  return [-1, 1].flatMap((up) => signs.map(([ahead, left]) => {
    const [a, b] = [(ahead * length) / 2, (left * width) / 2];
    return [x + c * a - s * b, y + s * a + c * b, z + (up * height) / 2];
  }));
}

export function boxOf(object) {
  const box = object.box_3d;
  return box && [...box.center_m, ...box.size_m, box.yaw_rad];
}

// Pixel of a point, null behind the camera; `rows` is the 3x4 matrix of the scene.
export function project(rows, [x, y, z]) {
  const [u, v, depth] = rows.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]);
  return depth > 0.5 ? [u / depth, v / depth] : null;
}

export function iou(a, b) {
  if (!a || !b) return 0;
  const width = Math.min(a[2], b[2]) - Math.max(a[0], b[0]);
  const height = Math.min(a[3], b[3]) - Math.max(a[1], b[1]);
  if (width <= 0 || height <= 0) return 0;
  const area = (box) => (box[2] - box[0]) * (box[3] - box[1]);
  return (width * height) / (area(a) + area(b) - width * height);
}

export function distance(a, b) {
  return Math.hypot(...minus(a, b));
}

function minus(a, b) {
  return a.map((each, index) => each - b[index]);
}

function dot(a, b) {
  return a.reduce((sum, each, index) => sum + each * b[index], 0);
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(a) {
  const length = Math.hypot(...a) || 1;
  return a.map((each) => each / length);
}
