// The drive's time line: health and alarms of each frame that was judged, and playing.

const ROWS = [["camera", "camera"], ["lidar", "LiDAR"], ["alignment", "alignment"]];
const LEFT = 74;
const HEIGHT = 26;

export class Drive {
  constructor(canvas, frames, colors) {
    Object.assign(this, { canvas, frames, colors, judged: new Map() });
  }

  // Forgets what was judged under other faults.
  under(faults) {
    if (this.faults !== faults) this.judged.clear();
    this.faults = faults;
  }

  add(frame, scores, alarms) {
    this.judged.set(frame, { scores, alarms });
  }

  // Frame at a place of the canvas [CSS px].
  frameAt(x) {
    const share = (x - LEFT) / (this.canvas.clientWidth - LEFT);
    const index = Math.floor(share * this.frames.length);
    return this.frames[Math.max(0, Math.min(this.frames.length - 1, index))];
  }

  draw(current) {
    const { canvas, frames } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = canvas.clientWidth;
    canvas.width = width * ratio;
    canvas.height = (ROWS.length * HEIGHT + 12) * ratio;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    const [text, line, bad] = ["--text", "--line", "--bad"].map((name) => style.getPropertyValue(name));
    const each = (width - LEFT) / frames.length;
    pen.font = "12px system-ui, sans-serif";
    ROWS.forEach(([name, title], row) => {
      const top = row * HEIGHT + 4;
      pen.fillStyle = text;
      pen.fillText(title, 0, top + 14);
      pen.strokeStyle = line;
      pen.strokeRect(LEFT, top, width - LEFT, HEIGHT - 6);
      frames.forEach((frame, index) => {
        const judged = this.judged.get(frame);
        const score = judged?.scores[name];
        if (score === undefined || score === null) return;
        const left = LEFT + index * each;
        const tall = Math.max(2, score * (HEIGHT - 6));
        pen.fillStyle = `rgb(${this.colors[Math.round((1 - score) * (this.colors.length - 1))]})`;
        pen.fillRect(left, top + HEIGHT - 6 - tall, Math.max(1, each - 1), tall);
        if (judged.alarms.includes(name)) {
          pen.fillStyle = bad;
          pen.fillRect(left, top, Math.max(1, each), 4);
        }
      });
    });
    const now = frames.indexOf(current);
    if (now < 0) return;
    pen.strokeStyle = text;
    pen.lineWidth = 2;
    pen.strokeRect(LEFT + now * each, 1, Math.max(2, each), ROWS.length * HEIGHT + 2);
  }
}

// The scores of a frame; `meanings` has the words for each check.
export function healthLines(place, parts, meanings) {
  place.replaceChildren(...ROWS.map(([name, title]) => {
    const line = document.createElement("div");
    line.className = "health";
    const judged = parts.health?.[name];
    const label = document.createElement("span");
    label.textContent = title;
    const meter = Object.assign(document.createElement("meter"), {
      min: 0, max: 1, low: 0.5, high: 0.5, optimum: 1, value: judged?.score ?? 0,
    });
    meter.setAttribute("aria-label", `Health of ${title}`);
    const text = document.createElement("span");
    if (!parts.health) text.textContent = "...";
    else if (!judged) text.textContent = "unknown";
    else if (judged.score < 0.5) {
      text.textContent = `\u26a0 ${judged.score.toFixed(2)} ${judged.worst}`;
      text.className = "alarm";
    } else text.textContent = `${judged.score.toFixed(2)} ok`;
    line.append(label, meter, text);
    return line;
  }));
  const yaw = parts.health?.yaw_deg;
  const note = document.createElement("small");
  note.textContent = yaw === null || yaw === undefined
    ? "Rotation between LiDAR and camera: not seen in this frame."
    : `Rotation between LiDAR and camera by their edges: ${yaw.toFixed(2)}\u00b0`;
  place.append(...badChecks(parts.health, meanings), note);
  if (parts.health) place.append(limitsLine(parts.health.limits));
}

function limitsLine(limits) {
  const line = document.createElement("small");
  line.textContent = `Limits: camera ${limits.camera}; LiDAR ${limits.lidar}.`;
  return line;
}

function badChecks(health, meanings) {
  const bad = ROWS.map(([name]) => health?.[name]).filter((each) => each && each.score < 0.5);
  return [...new Set(bad.map((each) => each.worst))].map((check) => {
    const line = document.createElement("small");
    line.textContent = `${check}: ${meanings[check]}`;
    return line;
  });
}
