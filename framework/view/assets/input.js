/* Mouse, fingers and keys, as calls on the eye. */

const KEYS = { KeyW: [2, 1], KeyS: [2, -1], KeyD: [0, 1], KeyA: [0, -1], KeyE: [1, -1], KeyQ: [1, 1] };
const ARROWS = { ArrowLeft: [30, 0], ArrowRight: [-30, 0], ArrowUp: [0, 30], ArrowDown: [0, -30] };
const SPEED = 0.7; // of flying: distances to what is looked at, per second

/* told: {moved(), tapped(x, y, double), hovered(x, y), flying() -> bool, scale() -> CSS pixels per photo pixel} */
function listen(stage, eye, told) {
  const fingers = new Map(), held = new Set();
  let travelled = 0, tapTime = 0, flownAt = null;
  const spot = (event) => {
    const box = stage.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = () => {
    const [[a, b], [c, d]] = [...fingers.values()];
    return { x: (a + c) / 2, y: (b + d) / 2, gap: Math.hypot(a - c, b - d) };
  };

  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest("input, button, select")) return;
    stage.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, spot(event));
    if (fingers.size === 1) travelled = 0;
    stage.focus({ preventScroll: true });
  });
  stage.addEventListener("pointermove", (event) => {
    const now = spot(event), before = fingers.get(event.pointerId);
    if (!before) return told.hovered(...now);
    const two = fingers.size === 2 ? spread() : null;
    fingers.set(event.pointerId, now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    travelled += Math.hypot(dx, dy);
    if (travelled < 4 || fingers.size > 2) return; // a tap may tremble
    if (two) {
      const after = spread();
      if (after.gap > 0 && two.gap > 0) eye.dolly(two.gap / after.gap);
      eye.pan(after.x - two.x, after.y - two.y, told.scale());
    } else if (event.buttons & 2 || event.buttons & 4 || event.shiftKey) {
      eye.pan(dx, dy, told.scale());
    } else {
      eye.turn(dx, dy, told.flying());
    }
    told.moved();
  });
  const lifted = (event) => {
    const there = fingers.get(event.pointerId);
    if (!fingers.delete(event.pointerId) || event.type === "pointercancel") return;
    if (travelled < 4 && fingers.size === 0 && event.button === 0) {
      const double = event.timeStamp - tapTime < 350;
      tapTime = double ? 0 : event.timeStamp;
      told.tapped(...there, double, event.pointerType === "touch" ? 26 : 14);
    }
  };
  stage.addEventListener("pointerup", lifted);
  stage.addEventListener("pointercancel", lifted);
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1, amount = clamp(event.deltaY * lines, -200, 200);
    if (told.flying()) eye.fly([0, 0, -amount / 400]);
    else eye.dolly(Math.exp(amount / 400));
    told.moved();
  }, { passive: false });

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, dialog")) return;
    if (event.code in KEYS) {
      held.add(event.code);
      told.moved();
    } else if (event.code in ARROWS) {
      eye.turn(...ARROWS[event.code], told.flying());
      event.preventDefault();
      told.moved();
    }
  });
  document.addEventListener("keyup", (event) => held.delete(event.code));
  window.addEventListener("blur", () => { held.clear(); fingers.clear(); });

  /* Fly by the keys that are held; whether any is. */
  return (now) => {
    const seconds = flownAt === null ? 0.016 : Math.min(0.2, (now - flownAt) / 1000);
    flownAt = held.size ? now : null;
    if (!held.size) return false;
    const steps = [0, 0, 0];
    for (const code of held) steps[KEYS[code][0]] += KEYS[code][1] * SPEED * seconds;
    eye.fly(steps);
    return true;
  };
}
