// Mouse, touch and keys on the picture: orbit, pan, zoom, and a click.

/** Distance after which a press is not a click, px. */
const CLICK_PX = 5;
/** Distance by which an arrow key moves the picture, px. */
const KEY_PX = 40;

/**
 * One finger or the left button turns the picture; in the view of a plane it moves the picture. Two fingers, another button or Shift move the picture; the
 * wheel and two fingers zoom.
 * @param {HTMLElement} element
 * @param {import("./camera.js").Camera} camera
 * @param {{changed: () => void, click: (x: number, y: number) => void, fit: () => void}} on
 */
export function follow(element, camera, on) {
  /** @type {Map<number, {x: number, y: number}>} */
  const pressed = new Map();
  let way = 0;
  let turns = false;
  const place = (/** @type {MouseEvent} */ event) => {
    const box = element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    pressed.set(event.pointerId, place(event));
    way = pressed.size > 1 ? CLICK_PX + 1 : 0;
    turns = event.button === 0 && !event.shiftKey;
  });
  element.addEventListener("pointermove", (event) => {
    const before = pressed.get(event.pointerId);
    if (!before) return;
    const now = place(event);
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    way += Math.hypot(dx, dy);
    pressed.set(event.pointerId, now);
    if (way <= CLICK_PX) return;
    const other = [...pressed].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const [far, near] = [Math.hypot(now.x - other.x, now.y - other.y), Math.hypot(before.x - other.x, before.y - other.y)];
      camera.pan(dx / 2, dy / 2);
      if (near > 0) camera.zoom(far / near, (now.x + other.x) / 2, (now.y + other.y) / 2);
    } else if (turns && !["XY", "XZ", "YZ"].includes(camera.view)) camera.orbit(dx, dy);
    else camera.pan(dx, dy);
    on.changed();
  });
  const release = (/** @type {PointerEvent} */ event) => {
    const at = pressed.get(event.pointerId);
    pressed.delete(event.pointerId);
    if (at && way <= CLICK_PX && event.type === "pointerup" && event.button === 0) on.click(at.x, at.y);
  };
  element.addEventListener("pointerup", release);
  element.addEventListener("pointercancel", release);
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", on.fit);
  element.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { x, y } = place(event);
    camera.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.03 : 0.0015)), x, y);
    on.changed();
  }, { passive: false });
  element.addEventListener("keydown", (event) => {
    const [x, y] = [camera.width / 2, camera.height / 2];
    const keys = /** @type {Record<string, () => void>} */ ({
      ArrowLeft: () => camera.pan(KEY_PX, 0), ArrowRight: () => camera.pan(-KEY_PX, 0),
      ArrowUp: () => camera.pan(0, KEY_PX), ArrowDown: () => camera.pan(0, -KEY_PX),
      "+": () => camera.zoom(1.25, x, y), "-": () => camera.zoom(0.8, x, y), 0: on.fit,
    });
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
    on.changed();
  });
}
