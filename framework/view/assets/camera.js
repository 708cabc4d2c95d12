/* Where the reader looks from: a pose, the distance of what it turns about, the lens of a photo. */

const TURN = 0.006; // radians per CSS pixel dragged
const JUMP_MS = 450;

class Eye {
  constructor(up) {
    this.up = up;
    this.flight = null;
    this.lens = { fx: 1, fy: 1, cx: 0.5, cy: 0.5, w: 1, h: 1 };
    this.pose = { R: [1, 0, 0, 0, 1, 0, 0, 0, 1], c: [0, 0, 0] };
    this.distance = 1;
    this.at = null; // index of the camera that it looks through
  }

  get forward() { return row(this.pose.R, 2); }
  get pivot() { return add(this.pose.c, this.forward, this.distance); }

  free() {
    this.flight = null;
    this.at = null;
  }

  /* about what it looks at, or with `still`, about itself */
  turn(dx, dy, still) {
    const { pivot } = this, up = row(this.pose.R, 1);
    this.free();
    // upside down the hand still pulls what it grasped
    const side = dot(up, this.up) > 0 ? -1 : 1, sign = still ? -1 : 1;
    let R = turnedPose(this.pose.R, this.up, -sign * side * dx * TURN);
    const tipped = turnedPose(R, row(R, 0), -sign * dy * TURN);
    const height = Math.abs(dot(row(tipped, 2), this.up));
    if (height < 0.99 || height < Math.abs(dot(row(R, 2), this.up))) R = tipped; // not over the pole
    this.pose = { R, c: still ? this.pose.c : add(pivot, row(R, 2), -this.distance) };
  }

  /* sideways, by CSS pixels at the depth of what it looks at */
  pan(dx, dy, scale) {
    this.free();
    const { R, c } = this.pose, k = this.distance / (this.lens.fx * scale);
    this.pose = { R, c: add(add(c, row(R, 0), -dx * k), row(R, 1), -dy * k) };
  }

  /* towards what it looks at; past it where it is close */
  dolly(factor) {
    const { pivot } = this;
    this.free();
    this.distance = Math.max(this.distance * factor, 1e-4);
    this.pose = { R: this.pose.R, c: add(pivot, this.forward, -this.distance) };
  }

  fly(steps) {
    this.free();
    let c = this.pose.c;
    steps.forEach((step, i) => { c = add(c, row(this.pose.R, i), step * this.distance); });
    this.pose = { R: this.pose.R, c };
  }

  /* to a camera (its index and itself), at once or in a short flight; `done` once it is there */
  jump(index, camera, distance, now, done) {
    const end = { pose: camera.pose, distance };
    this.lens = camera;
    this.at = null;
    const arrive = () => {
      Object.assign(this, end, { at: index, flight: null });
      done();
    };
    if (now === null) return arrive();
    const begin = { pose: this.pose, distance: this.distance };
    this.flight = (time) => {
      const share = clamp((time - now) / JUMP_MS, 0, 1), eased = share * share * (3 - 2 * share);
      if (share === 1) return arrive();
      this.pose = between(begin.pose, end.pose, eased);
      this.distance = begin.distance * (1 - eased) + end.distance * eased;
    };
  }

  /* CSS pixels of the photo's rectangle inside a pane of this size */
  rectangle(width, height) {
    const scale = Math.min(width / this.lens.w, height / this.lens.h);
    const w = scale * this.lens.w, h = scale * this.lens.h;
    return { scale, left: (width - w) / 2, top: (height - h) / 2, width: w, height: h };
  }

  /* the renderer's view for a pane of CSS pixels, drawn in `width` x `height` pixels */
  view(pane, width, height) {
    const { scale, left, top } = this.rectangle(pane.width, pane.height), { fx, fy, cx, cy } = this.lens;
    const [sx, sy] = [width / pane.width, height / pane.height];
    return {
      pose: this.pose, width, height, detail: scale * Math.sqrt(sx * sy), fx: fx * scale * sx, fy: fy * scale * sy,
      cx: (cx * scale + left) * sx, cy: (cy * scale + top) * sy,
    };
  }
}

/* The cameras as pyramids on a plain canvas above the splat, and which of them is under a finger. */
class Frustums {
  constructor(canvas, cameras) {
    this.canvas = canvas;
    this.cameras = cameras;
    this.size = 0.35 * typicalGap(cameras);
  }

  corners(camera) {
    const { R, c } = camera.pose, s = this.size;
    const spot = (u, v) => {
      const [x, y] = [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy];
      return add(add(add(c, row(R, 2), s), row(R, 0), x * s), row(R, 1), y * s);
    };
    return [c, spot(0, 0), spot(camera.w, 0), spot(camera.w, camera.h), spot(0, camera.h)];
  }

  draw(panes, eye, ratio, shown, hovered) {
    const { canvas } = this, ink = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const [width, height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio].map(Math.round);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    ink.setTransform(ratio, 0, 0, ratio, 0, 0);
    ink.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    this.spots = [];
    if (!shown) return;
    for (const pane of panes) {
      ink.save();
      ink.beginPath();
      ink.rect(pane.left, pane.top, pane.width, pane.height);
      ink.clip();
      const view = eye.view(pane, pane.width, pane.height);
      this.cameras.forEach((camera, i) => this.one(ink, style, pane, view, camera, i, i === hovered));
      ink.restore();
    }
  }

  one(ink, style, pane, view, camera, i, hovered) {
    if (length(add(camera.pose.c, view.pose.c, -1)) < 0.5 * this.size) return; // the eye is in it
    const points = this.corners(camera).map((p) => seen(view.pose, p)), near = 0.05 * this.size;
    const flat = (p) => [pane.left + view.fx * p[0] / p[2] + view.cx, pane.top + view.fy * p[1] / p[2] + view.cy];
    for (const [colour, thick] of [["--halo", 3.5], [camera.role === "test" ? "--test" : "--train", hovered ? 3 : 1.6]]) {
      ink.strokeStyle = style.getPropertyValue(colour);
      ink.lineWidth = thick;
      ink.beginPath();
      for (const [a, b] of [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]]) {
        let [p, q] = [points[a], points[b]];
        if (p[2] < near && q[2] < near) continue;
        const cut = (from, to) => add(from, add(to, from, -1), (near - from[2]) / (to[2] - from[2]));
        if (p[2] < near) p = cut(p, q);
        else if (q[2] < near) q = cut(q, p);
        ink.moveTo(...flat(p));
        ink.lineTo(...flat(q));
      }
      ink.stroke();
    }
    const middle = points.slice(1).reduce((sum, p) => add(sum, p, 0.25), [0, 0, 0]);
    for (const p of [points[0], middle]) if (p[2] > near) this.spots.push([i, ...flat(p), p[2]]);
  }

  /* index of the camera within `reach` CSS pixels, or null */
  under(x, y, reach) {
    let best = [null, reach];
    for (const [i, u, v] of this.spots ?? []) {
      const off = Math.hypot(u - x, v - y);
      if (off < best[1]) best = [i, off];
    }
    return best[0];
  }
}

/* Median distance of a camera to the next one; of one alone, 1. */
function typicalGap(cameras) {
  const gaps = cameras.map((a) => Math.min(...cameras.filter((b) => b !== a).map((b) => length(add(a.pose.c, b.pose.c, -1))).filter((gap) => gap > 0)));
  const found = gaps.filter(Number.isFinite).sort((a, b) => a - b);
  return found.length ? found[found.length >> 1] : 1;
}
