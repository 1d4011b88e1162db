// Orbit, pan and zoom by mouse, touch and keyboard.
const orbit = { yaw: 0, pitch: 0, distance: 0, target: [0, 0, 0], up: 1, fov: 0.6 };
function resetView() {
  const [yaw, pitch] = asset.view;
  // The bounding sphere fills the shorter side of the view.
  const aspect = canvas.clientWidth / canvas.clientHeight || 1;
  const half = Math.atan(Math.tan(orbit.fov / 2) * Math.min(1, aspect));
  Object.assign(orbit, { yaw, pitch, target: [0, 0, 0], distance: Math.hypot(...asset.half_extents) / Math.sin(half) });
}
function currentView() {
  const c = Math.cos(orbit.pitch), local = [c * Math.sin(orbit.yaw), Math.sin(orbit.pitch), c * Math.cos(orbit.yaw)];
  const away = orbit.up === 1 ? local : [local[0], -local[2], local[1]];
  const eye = orbit.target.map((x, i) => x + orbit.distance * away[i]);
  const up = orbit.up === 1 ? [0, 1, 0] : [0, 0, 1];
  return { eye, camera: lookAt(eye, orbit.target, up), fov: orbit.fov };
}
function turn(dx, dy) {
  orbit.yaw -= dx;
  orbit.pitch = Math.min(Math.max(orbit.pitch + dy, -1.55), 1.55);
}
function pan(dx, dy) {   // in parts of the height of the view
  const { camera } = currentView(), k = 2 * orbit.distance * Math.tan(orbit.fov / 2);
  orbit.target = orbit.target.map((x, i) => Math.min(Math.max(x + k * (dy * camera[3 + i] - dx * camera[i]), -2), 2));
}
function zoom(factor) { orbit.distance = Math.min(Math.max(orbit.distance * factor, 0.2), 60); }

function listen(moved) {
  const pointers = new Map();
  canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, e); });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, e => pointers.delete(e.pointerId));
  canvas.addEventListener("pointermove", e => {
    const last = pointers.get(e.pointerId), h = canvas.clientHeight;
    if (!last) return;
    const dx = e.clientX - last.clientX, dy = e.clientY - last.clientY;
    if (pointers.size === 2) {
      const other = [...pointers.values()].find(p => p.pointerId !== e.pointerId);
      const span = p => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY) + 1;
      zoom(span(last) / span(e));
      pan(dx / h / 2, dy / h / 2);
    } else if (e.shiftKey || e.buttons & 6) pan(dx / h, dy / h);
    else turn(4 * dx / h, 4 * dy / h);
    pointers.set(e.pointerId, e);
    moved();
  });
  canvas.addEventListener("contextmenu", e => e.preventDefault());
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(Math.max(-50, Math.min(50, e.deltaY)) * 0.003)); moved(); }, { passive: false });
  canvas.addEventListener("keydown", e => {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
    if (arrows && e.shiftKey) pan(arrows[0] * 0.05, arrows[1] * 0.05);
    else if (arrows) turn(arrows[0] * 0.1, arrows[1] * 0.1);
    else if (e.key === "+" || e.key === "=") zoom(0.9);
    else if (e.key === "-") zoom(1 / 0.9);
    else if (e.key === "0") resetView();
    else return;
    e.preventDefault();
    moved();
  });
}
