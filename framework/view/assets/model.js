/* The Gaussians of a run, from the bytes that framework/view/pack.py wrote. */

async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

async function readModel(run, text) {
  const { n, banded, rest } = run, bytes = await unpacked(text);
  let at = 0;
  const take = (Kind, count) => {
    const array = new Kind(bytes, at, count);
    at += array.byteLength;
    return array;
  };
  const means = take(Float32Array, 3 * n), logScales = take(Uint16Array, 3 * n), quats = take(Int16Array, 4 * n);
  const opacities = take(Uint16Array, n), sh0 = take(Uint16Array, 3 * n), bands = take(Uint8Array, 3 * rest * banded);
  const spread = (value, [low, high]) => low + (high - low) * value / 65535;
  const table = new Float32Array(16 * n); // mean and opacity, quaternion, scales, colour: four texels
  for (let i = 0; i < n; i++) {
    const o = 16 * i, q = 4 * i, size = Math.hypot(quats[q], quats[q + 1], quats[q + 2], quats[q + 3]) || 1;
    for (let k = 0; k < 3; k++) {
      table[o + k] = means[3 * i + k];
      table[o + 8 + k] = Math.exp(spread(logScales[3 * i + k], run.log_scales));
      table[o + 12 + k] = 0.5 + 0.28209479177387814 * spread(sh0[3 * i + k], run.sh0);
    }
    table[o + 3] = opacities[i] / 65535;
    for (let k = 0; k < 4; k++) table[o + 4 + k] = quats[q + k] / size;
  }
  return { n, banded, rest, means, opacities, table, bands, ranges: run.bands, background: run.background, near: run.near };
}

/* Indices of the Gaussians beyond the near plane, farthest first; of equal depth the later one. A
   radix sort of the depths' bits, which for positive floats are in the numbers' order. */
function farthestFirst(model, pose) {
  const { n, means } = model;
  const room = model.room ??= { keys: new Float32Array(n), ids: new Uint32Array(n), keys2: new Float32Array(n), ids2: new Uint32Array(n) };
  const [a, b, c] = row(pose.R, 2), t = -dot([a, b, c], pose.c);
  let { keys, ids, keys2, ids2 } = room, count = 0;
  for (let i = 0; i < n; i++) {
    const z = a * means[3 * i] + b * means[3 * i + 1] + c * means[3 * i + 2] + t;
    if (z >= model.near) {
      keys[count] = z;
      ids[count++] = i;
    }
  }
  let from = new Uint32Array(keys.buffer), to = new Uint32Array(keys2.buffer);
  for (const shift of [0, 11, 22]) {
    const starts = new Uint32Array(2049);
    for (let i = 0; i < count; i++) starts[((from[i] >>> shift) & 2047) + 1]++;
    for (let k = 0; k < 2048; k++) starts[k + 1] += starts[k];
    for (let i = 0; i < count; i++) {
      const place = starts[(from[i] >>> shift) & 2047]++, target = shift === 22 ? count - 1 - place : place;
      to[target] = from[i];
      ids2[target] = ids[i];
    }
    [from, to, ids, ids2] = [to, from, ids2, ids];
  }
  return ids.subarray(0, count);
}

/* Depths of the solid Gaussians that a view sees within `reach` (a share of its width) of a place in
   pixels, nearest first. */
function depthsAround(model, view, x, y, reach) {
  const found = [], near = (reach * view.width) ** 2;
  for (let i = 0; i < model.n; i++) {
    if (model.opacities[i] < 16000) continue;
    const p = seen(view.pose, [model.means[3 * i], model.means[3 * i + 1], model.means[3 * i + 2]]);
    if (p[2] < model.near) continue;
    const u = view.fx * p[0] / p[2] + view.cx, v = view.fy * p[1] / p[2] + view.cy;
    if ((u - x) ** 2 + (v - y) ** 2 <= near && u >= 0 && v >= 0 && u <= view.width && v <= view.height) found.push(p[2]);
  }
  return Float64Array.from(found).sort();
}
