// Files of what is seen: a picture and a line of JSON.

const CAPTION = 26; // pixels of the line above each view

// Saves the views that are shown, one below the other, each with its caption: pairs of both.
export function savePicture(name, views) {
  const shown = views.filter(([view]) => (view.naturalWidth ?? view.width) && view.clientWidth);
  const width = Math.max(...shown.map(([view]) => view.naturalWidth ?? view.width));
  const heights = shown.map(([view]) => {
    const [own, tall] = [view.naturalWidth ?? view.width, view.naturalHeight ?? view.height];
    return Math.round((tall * width) / own);
  });
  const sheet = document.createElement("canvas");
  Object.assign(sheet, { width, height: heights.reduce((sum, each) => sum + each + CAPTION, 0) });
  const pen = sheet.getContext("2d");
  pen.fillStyle = "#000";
  pen.fillRect(0, 0, sheet.width, sheet.height);
  pen.font = "15px system-ui, 'DejaVu Sans', sans-serif";
  let top = CAPTION;
  shown.forEach(([view, caption], index) => {
    pen.fillStyle = "#fff";
    pen.fillText(caption, 4, top - 8, width - 8);
    pen.drawImage(view, 0, top, width, heights[index]);
    top += heights[index] + CAPTION;
  });
  sheet.toBlob((blob) => save(`${name}.png`, blob), "image/png");
}

// A line as `sightline perceive` writes it, with the state beside.
export function saveLine(name, state, link, scene, parts) {
  const line = {
    frame: scene.frame,
    timestamp_s: scene.timestamp_s,
    image_size_px: scene.image_size_px,
    sensors: scene.sensors,
    num_points: scene.num_points,
    tasks: Object.fromEntries(Object.keys(state.weights).map((task) => {
      const { by, lacks } = parts[task] ?? {};
      return [task, lacks ? { by, lacks } : { by }];
    })),
    objects: parts.joined?.objects ?? null,
    detections2d: parts.detection2d?.detections2d ?? null,
    detections3d: parts.detection3d?.detections3d ?? null,
    depth: parts["depth-completion"]?.depth ?? null,
    health: parts.health ?? null,
    faults: state.faults,
    yaw_deg: state.yaw,
    link,
  };
  save(`${name}.json`, new Blob([`${JSON.stringify(line)}\n`], { type: "application/json" }));
}

function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
