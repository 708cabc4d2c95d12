/* A pose is {R, c}: the camera's axes right, down, forward as the rows of R (nine numbers, so that R
   takes the world to the camera) and its centre c. */

const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.sqrt(dot(a, a));
const unit = (a) => a.map((v) => v / (length(a) || 1));
const clamp = (v, low, high) => Math.min(high, Math.max(low, v));
const row = (R, i) => R.slice(3 * i, 3 * i + 3);
const times = (R, p) => [dot(row(R, 0), p), dot(row(R, 1), p), dot(row(R, 2), p)];
const seen = (pose, p) => times(pose.R, add(p, pose.c, -1));

/* p turned by an angle (radians) about a unit axis: Rodrigues' formula */
function turned(p, axis, angle) {
  const k = Math.cos(angle), s = Math.sin(angle), along = dot(axis, p) * (1 - k), side = cross(axis, p);
  return p.map((v, i) => v * k + side[i] * s + axis[i] * along);
}

/* orthonormal again, after many turns */
function tidied(R) {
  const forward = unit(row(R, 2)), right = unit(cross(row(R, 1), forward));
  return [...right, ...cross(forward, right), ...forward];
}

const turnedPose = (R, axis, angle) => tidied([0, 1, 2].flatMap((i) => turned(row(R, i), axis, angle)));

function quatOf(R) {
  const w = Math.sqrt(Math.max(0, 1 + R[0] + R[4] + R[8])) / 2, x = Math.sqrt(Math.max(0, 1 + R[0] - R[4] - R[8])) / 2;
  const y = Math.sqrt(Math.max(0, 1 - R[0] + R[4] - R[8])) / 2, z = Math.sqrt(Math.max(0, 1 - R[0] - R[4] + R[8])) / 2;
  const q = [w, x, y, z], most = q.indexOf(Math.max(...q)), d = 4 * q[most];
  const wx = R[7] - R[5], wy = R[2] - R[6], wz = R[3] - R[1], xy = R[1] + R[3], xz = R[2] + R[6], yz = R[5] + R[7];
  return [[w, wx / d, wy / d, wz / d], [wx / d, x, xy / d, xz / d], [wy / d, xy / d, y, yz / d], [wz / d, xz / d, yz / d, z]][most];
}

function rotationOf([w, x, y, z]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

/* from a (share 0) to b (share 1), turning evenly enough for half a second */
function between(a, b, share) {
  const p = quatOf(a.R), q = quatOf(b.R);
  const sign = p.reduce((sum, v, i) => sum + v * q[i], 0) < 0 ? -1 : 1;
  const mixed = p.map((v, i) => v * (1 - share) + sign * q[i] * share), size = Math.hypot(...mixed);
  return { R: rotationOf(mixed.map((v) => v / size)), c: a.c.map((v, i) => v * (1 - share) + b.c[i] * share) };
}
