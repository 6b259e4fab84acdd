// Files of what is seen: a picture and a line of JSON.

export function savePicture(name, canvases) {
  const shown = canvases.filter((each) => (each.naturalWidth ?? each.width) && each.clientWidth);
  const width = Math.max(...shown.map((each) => each.naturalWidth ?? each.width));
  const heights = shown.map((each) => {
    const [own, tall] = [each.naturalWidth ?? each.width, each.naturalHeight ?? each.height];
    return Math.round((tall * width) / own);
  });
  const sheet = document.createElement("canvas");
  Object.assign(sheet, { width, height: heights.reduce((sum, each) => sum + each + 6, 0) });
  const pen = sheet.getContext("2d");
  pen.fillStyle = "#000";
  pen.fillRect(0, 0, sheet.width, sheet.height);
  let top = 0;
  shown.forEach((each, index) => {
    pen.drawImage(each, 0, top, width, heights[index]);
    top += heights[index] + 6;
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
