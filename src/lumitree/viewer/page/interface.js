// Controls, the two tabs, and when to draw.
const $ = id => document.getElementById(id);
const colours = makeTexture(gl.LINEAR);
gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE,
  Uint8Array.from({ length: 1024 }, (_, i) => i % 4 === 3 ? 255 : asset.colours[3 * (i >> 2) + i % 4]));
const background = makeTexture(gl.LINEAR);
gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([90, 90, 90, 255]));
const display = makeProgram("display", shaders.agx), wallDisplay = makeProgram("walls");
// An image takes at most this long while the view moves; it is then drawn with fewer pixels.
const MOVING_MS = 33, STILL_AFTER_MS = 180;
const state = { tab: "lamp", keys: new Map(), scale: 1, moving: 0, timer: 0, dirty: true, shown: true, room: [], lux: null, places: [] };
const WALLS = ["−x", "+x", "−y", "+y", "−z", "+z"];
const number = x => x === 0 ? "0" : Math.abs(x) >= 1e5 || Math.abs(x) < 1e-3 ? x.toExponential(1) : String(+x.toPrecision(3));

function schedule({ field: changed = false, moving = false } = {}) {
  state.dirty ||= changed;
  if (moving) {
    state.moving = performance.now();
    clearTimeout(state.timer);
    state.timer = setTimeout(() => { state.moving = 0; schedule({ field: true }); }, STILL_AFTER_MS);
  }
  if (state.pending) return;
  state.pending = true;
  requestAnimationFrame(() => { state.pending = false; if (state.loaded) (state.tab === "lamp" ? drawLamp : drawWalls)(); });
}

function resize() {
  const ratio = Math.min(window.devicePixelRatio || 1, 3);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
}

// Backdrop that is a file.
const IMAGE = "2", STUDIO = "3";
// The last mode shows the geometry, the others the field.
const MODEL = 4, source = () => +$("mode").value === MODEL ? model : field;
function drawLamp() {
  resize();
  const shown = source();
  if (state.dirty) shown.restart();
  if (!shown.complete) {
    const scale = state.moving ? state.scale : 1;
    const width = Math.max(1, Math.round(canvas.width * scale)), height = Math.max(1, Math.round(canvas.height * scale));
    const ms = shown.draw(currentView(), width, height);
    // Pixels in proportion to the time that there is.
    state.scale = Math.min(1, Math.max(0.1, Math.sqrt(MOVING_MS / Math.max(ms, 0.5)) * scale));
    $("ms").textContent = `${ms.toFixed(1)} ms, ${width} × ${height}`;
    state.dirty = false;
    if (!shown.complete && !state.moving) schedule();
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, canvas.width, canvas.height);
  const mode = +$("mode").value, stops = +$("exposure").value;
  draw(display, {
    radiance: shown.target.textures[0], seen: model.target.textures[1], soft: model.target.textures[2], details: field.target.textures[1], background, colours,
    resolution: [canvas.width, canvas.height], gain: state.keys.get(shown)[$("backdrop").value === STUDIO ? "studio" : "alone"] * 2 ** stops, max_density: field.maxDensity,
    studio_backdrop: asset.studio.backdrop, brightness: 2 ** stops, modelled: int(mode === MODEL ? 1 : 0),
    tree_depth: asset.field?.tree_depth ?? 0, mode: int(mode === MODEL ? 0 : mode), curve: int(+$("curve").value), backdrop: int(+$("backdrop").value),
  });
  $("another").hidden = $("backdrop").value !== IMAGE;
  $("exposure-text").textContent = `${stops > 0 ? "+" : ""}${stops} stops`;
  $("marks").replaceChildren();
  if (mode === 2) legend([0, 1, 2, 3, 4].map(i => [i / 4, number(field.maxDensity * 10 ** (i - 4))]), "mean density of the leaves on the ray, per half of the longest side");
  else if (mode === 3) legend(Array.from({ length: asset.field.tree_depth + 1 }, (_, i) => [i / asset.field.tree_depth, String(i)]), "depth of the first leaf");
  else $("legend").hidden = true;
}

// Samples of the image from which the exposure is taken.
const METERED = 16;
// Radiance that counts as black, relative to the largest.
const DARK = 1e-4;
// Filmic curves show as white what is a stop brighter.
const FILMIC = 2;
// The scales of radiance at 0 stops: alone the log-average of the pixels of the lamp is middle grey; in
// the studio the brightest of them are as bright as in photographs (lumitree.rendering.studio).
function meter(shown) {
  shown.restart();
  for (let i = 0; i < METERED && !shown.complete; ++i) shown.draw(currentView(), 160, 120);
  const pixels = readTarget(shown.target), lit = [], bright = [];
  for (let i = 0; i < pixels.length; i += 4) {
    const largest = Math.max(pixels[i], pixels[i + 1], pixels[i + 2]);
    if (largest > 0) bright.push(largest);
    // A light field hides almost nothing.
    if (shown === model || asset.has_field ? pixels[i + 3] < 0.99 : pixels[i + 3] < 1) lit.push(0.2126 * pixels[i] + 0.7152 * pixels[i + 1] + 0.0722 * pixels[i + 2]);
  }
  bright.sort((a, b) => a - b);
  const studio = bright.length ? asset.studio.own * FILMIC * 0.9 / bright[Math.round(0.98 * (bright.length - 1))] : 1;
  const dark = DARK * lit.reduce((a, b) => Math.max(a, b), 0);
  const alone = dark > 0 ? 0.18 / Math.exp(lit.reduce((sum, x) => sum + Math.log(x + dark), 0) / lit.length) : 1;
  return { alone, studio };
}

function legend(ticks, title) {
  $("legend").hidden = false;
  const context = $("bar").getContext("2d");
  for (let i = 0; i < 256; ++i) {
    context.fillStyle = `rgb(${asset.colours.slice(3 * i, 3 * i + 3)})`;
    context.fillRect(i, 0, 1, 12);
  }
  $("bar").title = title;
  $("bar").setAttribute("aria-label", title);
  $("ticks").replaceChildren(...ticks.map(([x, text]) => Object.assign(document.createElement("span"), { textContent: text, style: `left:${100 * x}%` })));
}

function drawWalls() {
  resize();
  const begin = performance.now();
  if (state.dirty) {
    state.lux = walls.draw(state.room, state.moving ? 1 : 4);
    state.dirty = false;
    tabulate();
    $("ms").textContent = `${(performance.now() - begin).toFixed(1)} ms`;
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(0.043, 0.043, 0.043, 1);
  gl.clear(gl.COLOR_BUFFER_BIT);
  layOut();
  const marks = [];
  for (const place of state.places) {
    const { wall, area } = place;
    gl.viewport(...area.map(Math.round));
    draw(wallDisplay, { lux: walls.target.textures[0], colours, wall: int(wall), patches: int(PATCHES), area, flip: place.flip, swap: int(place.swap), lowest: state.lowest, highest: state.highest });
    const k = canvas.clientHeight / canvas.height;
    marks.push(Object.assign(document.createElement("span"), { textContent: WALLS[wall], style: `left:${area[0] * k + 6}px;top:${(canvas.height - area[1] - area[3]) * k + 6}px` }));
  }
  $("marks").replaceChildren(...marks);
  const ticks = [], range = Math.log(state.highest / state.lowest);
  for (let decade = Math.floor(Math.log10(state.lowest)); 10 ** decade <= state.highest; ++decade)
    for (const m of [1, 2, 5]) {
      const x = Math.log(m * 10 ** decade / state.lowest) / range;
      if (x >= -1e-6 && x <= 1 + 1e-6) ticks.push([x, number(m * 10 ** decade)]);
    }
  legend(ticks.map(([x, text], i) => [x, i === ticks.length - 1 ? `${text} lx` : text]), "illuminance, lx; isolux lines at the numbers");
}

// The box unfolded: the lower wall in the middle of a cross, the upper one at its end.
function layOut() {
  const v = orbit.up, [h, d] = v === 1 ? [0, 2] : [0, 1], [x, y, z] = [state.room[h], state.room[v], state.room[d]];
  const width = 2 * (2 * x + 2 * y), height = 2 * (z + 2 * y), margin = 0.04;
  const k = Math.min(canvas.width / width, canvas.height / height) * (1 - 2 * margin);
  const left = (canvas.width - k * width) / 2, bottom = (canvas.height - k * height) / 2;
  const X = [0, 2 * y, 2 * y + 2 * x, 4 * y + 2 * x], Y = [0, 2 * y, 2 * y + 2 * z];
  // [wall, column, row, width, height, axis along the canvas's x, does it fall, does y fall]
  const s = v === 1 ? 1 : 0;   // for y up, z falls upwards on the canvas
  const rows = [
    [2 * v, X[1], Y[1], 2 * x, 2 * z, h, 0, s],
    [2 * h, X[0], Y[1], 2 * y, 2 * z, v, 1, s],
    [2 * h + 1, X[2], Y[1], 2 * y, 2 * z, v, 0, s],
    [2 * v + 1, X[3], Y[1], 2 * x, 2 * z, h, 1, s],
    [2 * d + s, X[1], Y[0], 2 * x, 2 * y, h, 0, 1],
    [2 * d + 1 - s, X[1], Y[2], 2 * x, 2 * y, h, 0, 0],
  ];
  state.places = rows.map(([wall, px, py, w, hgt, across, fx, fy]) => {
    const axis = wall >> 1, first = axis === 0 ? 1 : 0;
    return { wall, area: [left + k * px, bottom + k * py, k * w, k * hgt], swap: across === first ? 0 : 1, flip: [fx, fy] };
  });
}

function tabulate() {
  const rows = [];
  let largest = 0, least = Infinity;
  for (let wall = 0; wall < 6; ++wall) {
    let sum = 0, most = 0;
    for (let j = 0; j < PATCHES; ++j)
      for (let i = 0; i < PATCHES; ++i) {
        const e = state.lux[4 * (j * 6 * PATCHES + wall * PATCHES + i)];
        sum += e;
        most = Math.max(most, e);
        least = Math.min(least, e);
      }
    largest = Math.max(largest, most);
    rows.push(`<tr><td>${WALLS[wall]}</td><td>${number(sum / PATCHES ** 2)}</td><td>${number(most)}</td></tr>`);
  }
  document.querySelector("#means tbody").innerHTML = rows.join("");
  // The scale spans at most three decades, and changes only in steps of the isolux lines.
  const step = (e, up) => { const d = Math.floor(Math.log10(e)), m = e / 10 ** d; return 10 ** d * (up ? (m <= 2 ? 2 : m <= 5 ? 5 : 10) : (m >= 5 ? 5 : m >= 2 ? 2 : 1)); };
  state.highest = step(Math.max(largest, 1e-20), true);
  state.lowest = step(Math.max(least, state.highest / 1000, 1e-21), false);
}

function readOut(e) {
  if (state.tab !== "walls" || !state.lux) return;
  const k = canvas.height / canvas.clientHeight, box = canvas.getBoundingClientRect();
  const x = (e.clientX - box.left) * k, y = canvas.height - (e.clientY - box.top) * k;
  const place = state.places.find(({ area: a }) => x >= a[0] && x < a[0] + a[2] && y >= a[1] && y < a[1] + a[3]);
  if (!place) return void ($("readout").textContent = "\u00a0");
  let uv = [(x - place.area[0]) / place.area[2], (y - place.area[1]) / place.area[3]].map((u, i) => place.flip[i] ? 1 - u : u);
  if (place.swap) uv.reverse();
  const [i, j] = uv.map(u => Math.min(PATCHES - 1, Math.max(0, Math.floor(u * PATCHES))));
  $("readout").textContent = `Wall ${WALLS[place.wall]}: ${number(state.lux[4 * (j * 6 * PATCHES + place.wall * PATCHES + i)])} lx`;
}

function readSides(moving) {
  document.querySelectorAll(".side").forEach((input, k) => {
    // From 1.1 to 20 times the longest side, and always outside the lamp.
    state.room[k] = Math.max(1.1 * 18.2 ** +input.value, 1.05 * asset.half_extents[k]);
    input.parentElement.querySelector("output").textContent = number(2 * state.room[k] * asset.scale);
  });
  schedule({ field: true, moving });
}

function selectTab(tab) {
  state.tab = tab;
  for (const name of ["lamp", "walls"]) {
    $(`tab-${name}`).setAttribute("aria-selected", String(name === tab));
    $(`tab-${name}`).tabIndex = name === tab ? 0 : -1;
    $(`panel-${name}`).hidden = name !== tab;
  }
  schedule({ field: true });
}

function connect() {
  $("name").textContent = asset.luminaire;
  const count = x => x.toLocaleString("en"), { field: shown } = asset;
  const figures = { Shown: asset.shown,
    ...(asset.model ? { Triangles: count(asset.model.triangles) } : {}),
    ...(!shown ? {} : asset.has_field ? { Law: shown.law, "l_max": shown.l_max, Leaves: count(shown.leaves) } : { Cells: count(shown.leaves) }),
    ...(shown ? { Depth: shown.tree_depth } : {}), Size: `${(asset.bytes / 1e6).toFixed(2)} MB`, Frame: "" };
  $("figures").replaceChildren(...Object.entries(figures).flatMap(([name, value]) => [
    Object.assign(document.createElement("dt"), { textContent: name }),
    Object.assign(document.createElement("dd"), { textContent: value, id: name === "Frame" ? "ms" : `figure-${name}` })]));
  $("tabs").hidden = !asset.light_field;
  for (const id of ["exposure", "curve", "backdrop"]) $(id).addEventListener("input", () => schedule());
  $("mode").addEventListener("input", () => schedule({ field: true }));
  let chosen = $("backdrop").value;
  $("backdrop").addEventListener("change", () => {
    if ($("backdrop").value === IMAGE) $("file").click();
    else chosen = $("backdrop").value;
  });
  $("another").addEventListener("click", () => $("file").click());
  // No image was chosen: the backdrop is what it was.
  $("file").addEventListener("cancel", () => { $("backdrop").value = chosen; schedule(); });
  $("file").addEventListener("change", async () => {
    const file = $("file").files[0];
    $("file").value = "";
    if (!file) return;
    try {
      let image = await createImageBitmap(file);
      const part = gl.getParameter(gl.MAX_TEXTURE_SIZE) / Math.max(image.width, image.height);
      if (part < 1) {
        const [resizeWidth, resizeHeight] = [image.width, image.height].map(side => Math.max(1, Math.floor(part * side)));
        image = await createImageBitmap(file, { resizeWidth, resizeHeight });
      }
      gl.bindTexture(gl.TEXTURE_2D, background);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      chosen = IMAGE;
    } catch {
      // Not an image that this browser can read.
      $("backdrop").value = chosen;
    }
    schedule();
  });
  $("up").addEventListener("input", () => { orbit.up = +$("up").value; schedule({ field: true }); });
  $("reset").addEventListener("click", () => { resetView(); schedule({ field: true }); });
  document.querySelectorAll(".side").forEach(input => { input.value = 0.35; input.addEventListener("input", () => readSides(true)); });
  for (const tab of ["lamp", "walls"]) {
    $(`tab-${tab}`).addEventListener("click", () => selectTab(tab));
    $(`tab-${tab}`).addEventListener("keydown", e => {
      if (e.key !== "ArrowLeft" && e.key !== "ArrowRight") return;
      const other = tab === "lamp" ? "walls" : "lamp";
      selectTab(other);
      $(`tab-${other}`).focus();
    });
  }
  listen(() => { if (state.tab === "lamp") schedule({ field: true, moving: true }); });
  canvas.addEventListener("pointermove", readOut);
  new ResizeObserver(() => schedule({ field: true })).observe(canvas);
}

const toBase64 = array => {
  const bytes = new Uint8Array(array.buffer);
  let text = "";
  for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
  return btoa(text);
};
async function start() {
  const arrays = await unpackArrays();
  if (asset.field) field.load(arrays);
  if (asset.model) await model.load(arrays);
  if (asset.light_field) walls.load(arrays);
  resetView();
  $("exposure").value = asset.exposure;
  connect();
  for (const [mode, available] of [[MODEL, asset.model], [0, asset.field], [1, asset.field], [2, asset.field], [3, asset.field]])
    if (!available) $("mode").querySelector(`[value="${mode}"]`).remove();
  for (const [each, available] of [[model, asset.model], [field, asset.field]])
    if (available) state.keys.set(each, meter(each));
  state.loaded = true;
  readSides(false);
  readAddress();
  window.addEventListener("hashchange", readAddress);
}

// The part of the address after # sets the state, as #tab=walls&mode=3&stops=2.
function readAddress() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  for (const [name, id] of [["mode", "mode"], ["stops", "exposure"], ["tone", "curve"], ["background", "backdrop"], ["up", "up"]]) {
    const value = wanted.get(name), choices = $(id).options;
    // Not all assets have all choices.
    if (value !== null && (!choices || [...choices].some(each => each.value === value))) $(id).value = value;
  }
  orbit.up = +$("up").value;
  for (const name of ["yaw", "pitch"]) if (wanted.has(name)) orbit[name] = +wanted.get(name) || 0;
  selectTab(asset.light_field && wanted.get("tab") === "walls" ? "walls" : "lamp");
}

// For programs: linear radiance, transmittance and counts as float32 in base64, bottom row first.
window.lumitree = {
  ready: start().catch(error => { fail(error.message); }),
  async image({ eye, target, up, fov, width, height, samples = 64 }) {
    await this.ready;
    const view = { eye, camera: lookAt(eye, target, up), fov }, shown = asset.model ? model : field;
    let ms = 0;
    shown.restart();
    for (let i = 0; i < samples && !shown.complete; ++i) ms += shown.draw(view, width, height);
    const { max_radiance } = asset.model ?? asset.field;
    const radiance = readTarget(shown.target, 0).map((x, i) => i % 4 === 3 ? x : x * max_radiance);
    const more = (asset.model ? ["seen", "soft"] : ["details"]).map((name, i) => [name, toBase64(readTarget(shown.target, 1 + i))]);
    return { ms, radiance: toBase64(radiance), ...Object.fromEntries(more) };
  },
  async illuminance({ room, samples, patches }) {
    await this.ready;
    const begin = performance.now(), pixels = walls.draw(room, samples, patches);
    return { ms: performance.now() - begin, lux: toBase64(pixels.filter((_, i) => i % 4 === 0)) };
  },
};
