// Points as the server packs them: count, step, then x, y, z (int16), reflectance, fault.

export function unpack(buffer) {
  const header = new DataView(buffer);
  return {
    count: header.getUint32(0, true),
    step: header.getFloat32(4, true),
    bytes: new Uint8Array(buffer, 8),
  };
}
