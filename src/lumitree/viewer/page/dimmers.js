// Controls of an image with dimmers, and the command that mixes the same image.
const $ = id => document.getElementById(id);
const state = {};
const [COLDEST, HOTTEST] = [1500, 12000];
const percent = level => `${+(100 * level).toPrecision(level < 0.1 ? 2 : 3)} %`;
const kelvins = t => `${(10 * Math.round(t / 10)).toLocaleString("en")} K`;
const signed = stops => `${stops >= 0 ? "+" : ""}${+stops.toFixed(3)}`;
const number = x => String(+x.toPrecision(5));

// Sliders follow the square law of dimmers up to 100 %, and are logarithmic up to 200 %.
const levelOf = position => position <= 100 ? (position / 100) ** 2 : 2 ** (position / 100 - 1);
const positionOf = level => level <= 1 ? 100 * Math.sqrt(level) : 100 * (1 + Math.log2(level));

// A row of `content.temperatures`, whose temperatures are equally spaced in logarithms, between two.
function tabulated(table, temperature) {
  const { lowest, highest } = content.temperatures, last = table.length - 1;
  const at = Math.min(Math.max(Math.log(temperature / lowest) / Math.log(highest / lowest), 0), 1) * last;
  const i = Math.min(Math.floor(at), last - 1), f = at - i;
  return table[i].map((x, k) => (1 - f) * x + f * table[i + 1][k]);
}

// Factors on R, G and B of a lamp.
function gainOf({ on, level, kelvin }, lamp) {
  const tint = kelvin === null ? lamp.tint : tabulated(content.temperatures.colours, kelvin).map((x, c) => x / lamp.colour[c]);
  return tint.map(x => (on ? level : 0) * x);
}
function adaptation() {
  const { balance } = state;
  return balance === "auto" ? content.automatic : balance === "off" ? [1, 0, 0, 0, 1, 0, 0, 0, 1] : tabulated(content.temperatures.adaptations, balance);
}

function commandText(gains) {
  const quoted = text => /^[\w.,:=+/-]+$/.test(text) ? text : `'${text.replace(/'/g, "'\\''")}'`;
  const name = content.file ?? "layers.exr";
  const words = ["lumitree mix", quoted(name), "-o", quoted(name.replace(/(\.\w+)?$/, ".png"))];
  gains.forEach((gain, i) => {
    const texts = gain.map(number), alike = texts.every(text => text === texts[0]);
    if (!alike || texts[0] !== "1") words.push("--gain", quoted(`${lamps[i].name}=${alike ? texts[0] : texts}`));
  });
  const { stops, balance, view, bloom } = state;
  words.push(`--exposure=${signed(stops)}`, "--white-balance", typeof balance === "string" ? balance : number(balance), "--view", view, "--bloom", number(bloom));
  return words.join(" ");
}
function placementsText(gains) {
  const tables = lamps.map(({ name, placement, factors }, i) => {
    const gain = `gain = [${gains[i].map((x, c) => number(x * factors[c])).join(", ")}]`;
    return placement === null ? `# ${name}: ${gain}, of emitters in the scene` : `${placement}${gain}\n`;
  });
  return tables.join("\n");
}

function show() {
  const gains = lamps.map((lamp, i) => gainOf(state.lamps[i], lamp));
  state.gains = gains.flat();
  drawPhotograph({ gains: state.gains, exposure: 2 ** state.stops, share: state.bloom, adaptation: adaptation(), clip: state.view === "srgb" });
  $("command").value = commandText(gains);
  $("placements").value = placementsText(gains);
}
function schedule() {
  if (state.pending) return;
  state.pending = true;
  requestAnimationFrame(() => { state.pending = false; show(); });
}

// The state of the page when it was made; the controls show it.
function reset() {
  const { stops, balance, view, bloom } = content.initial;
  Object.assign(state, { stops, balance, view, bloom, lamps: lamps.map(({ level }) => ({ on: true, level, kelvin: null })) });
  lamps.forEach((_, i) => showLamp(i));
  showOthers();
  schedule();
}
function setText(id, text) { $(id).closest("label").querySelector("output").textContent = text; }
function showOthers() {
  const { stops, balance, view, bloom } = state;
  $("exposure").value = stops;
  setText("exposure", `${signed(stops)} stops`);
  $("curve").value = view;
  $("bloom").value = bloom;
  setText("bloom", percent(bloom));
  $("balance").value = typeof balance === "string" ? balance : "kelvin";
  $("kelvin").hidden = typeof balance === "string";
  if (typeof balance !== "string") $("kelvin").value = Math.log(balance);
  setText("balance", balance === "off" ? "" : balance !== "auto" ? kelvins(balance) : content.automatic_kelvin ? kelvins(content.automatic_kelvin) : "none");
}
function showLamp(i) {
  const { on, level, kelvin } = state.lamps[i], { row, own } = lamps[i];
  row.classList.toggle("off", !on);
  row.querySelector("button").setAttribute("aria-pressed", String(on));
  const [dimmer, colour] = row.querySelectorAll("input");
  dimmer.value = positionOf(level);
  dimmer.setAttribute("aria-valuetext", percent(level));
  colour.value = Math.log(kelvin ?? own ?? 4000);
  const text = kelvin !== null ? kelvins(kelvin) : own ? kelvins(own) : "own colour";
  colour.setAttribute("aria-valuetext", text);
  row.querySelector("output").textContent = `${on ? percent(level) : "off"}, ${text}`;
}
function changeLamp(i, changes) {
  Object.assign(state.lamps[i], changes);
  showLamp(i);
  schedule();
}

const element = (tag, values) => Object.assign(document.createElement(tag), values);
function makeRow(lamp, i) {
  const button = element("button", { textContent: lamp.name === "room" ? "room: all other light" : lamp.name, title: `Switch off or on${i < 9 ? `, key ${i + 1}` : ""}` });
  const dimmer = element("input", { type: "range", min: 0, max: Math.max(200, positionOf(lamp.level)), step: 0.5 });
  const colour = element("input", { type: "range", min: Math.log(COLDEST), max: Math.log(HOTTEST), step: 0.01, className: "colour", title: "Colour temperature; double click or Delete: as it was" });
  dimmer.setAttribute("aria-label", `Brightness of ${lamp.name}`);
  colour.setAttribute("aria-label", `Colour temperature of ${lamp.name}`);
  lamp.row = element("section", {});
  lamp.row.append(button, element("output", {}), dimmer, colour);
  button.addEventListener("click", () => changeLamp(i, { on: !state.lamps[i].on }));
  dimmer.addEventListener("input", () => changeLamp(i, { on: true, level: levelOf(+dimmer.value) }));
  colour.addEventListener("input", () => changeLamp(i, { kelvin: Math.exp(+colour.value) }));
  colour.addEventListener("dblclick", () => changeLamp(i, { kelvin: null }));
  colour.addEventListener("keydown", event => { if (event.key === "Delete") changeLamp(i, { kelvin: null }); });
  return lamp.row;
}

// The lamps that give most of the light where a pointer is.
function point(event) {
  const box = canvas.getBoundingClientRect(), k = Math.min(box.width / width, box.height / height);
  const x = (event.clientX - box.left - (box.width - k * width) / 2) / k, y = (event.clientY - box.top - (box.height - k * height) / 2) / k;
  const light = x < 0 || y < 0 || x >= width || y >= height ? [] : probe(state.gains, Math.floor(x), Math.floor(y));
  const sum = light.reduce((a, b) => a + b, 0), order = light.map((_, i) => i).sort((a, b) => light[b] - light[a]);
  const brightest = sum > 0 ? order[0] : -1;
  lamps.forEach(({ row }, i) => row.classList.toggle("pointed", i === brightest));
  $("tip").hidden = !(sum > 0);
  if (!(sum > 0)) return;
  $("tip").textContent = order.filter(i => light[i] > 0.05 * sum).slice(0, 3).map(i => `${lamps[i].name} ${Math.round(100 * light[i] / sum)} %`).join(", ");
  $("tip").style.left = `${Math.min(event.clientX - box.left + 12, box.width - $("tip").offsetWidth - 4)}px`;
  $("tip").style.top = `${Math.max(event.clientY - box.top - 34, 2)}px`;
  if (event.type === "pointerdown") lamps[brightest].row.scrollIntoView({ block: "nearest" });
}

function connect() {
  $("name").textContent = content.title;
  $("lamps").replaceChildren(...lamps.map(makeRow));
  const { stops, bloom } = content.initial;
  // Steps are counted from the lower end, so the first value is one of them.
  Object.assign($("exposure"), { min: stops - 8, max: stops + 8 });
  $("bloom").max = Math.max(0.5, bloom);
  Object.assign($("kelvin"), { min: Math.log(COLDEST), max: Math.log(HOTTEST) });
  const others = () => { showOthers(); schedule(); };
  $("exposure").addEventListener("input", () => { state.stops = +$("exposure").value; others(); });
  $("curve").addEventListener("input", () => { state.view = $("curve").value; others(); });
  $("bloom").addEventListener("input", () => { state.bloom = +$("bloom").value; others(); });
  $("balance").addEventListener("input", () => {
    const chosen = $("balance").value;
    state.balance = chosen === "kelvin" ? content.automatic_kelvin ?? 6500 : chosen;
    others();
  });
  $("kelvin").addEventListener("input", () => { state.balance = Math.round(Math.exp(+$("kelvin").value)); others(); });
  $("reset").addEventListener("click", reset);
  for (const id of ["command", "placements"])
    $(`copy-${id}`).addEventListener("click", () => {
      $(id).select();
      // Pages from a disk may not have the newer interface of the clipboard.
      document.execCommand("copy");
    });
  let latest = null;
  const later = event => {
    if (!latest) requestAnimationFrame(() => { point(latest); latest = null; });
    latest = event;
  };
  canvas.addEventListener("pointermove", later);
  canvas.addEventListener("pointerdown", later);
  canvas.addEventListener("pointerleave", () => { $("tip").hidden = true; lamps.forEach(({ row }) => row.classList.remove("pointed")); });
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey || ["SELECT", "TEXTAREA"].includes(event.target.tagName)) return;
    if (event.key === "0") reset();
    else if (lamps[event.key - 1]) changeLamp(event.key - 1, { on: !state.lamps[event.key - 1].on });
  });
}

async function start() {
  Object.assign(canvas, { width, height });
  canvas.parentElement.style.setProperty("--ratio", width / height);
  const note = text => Object.assign($("message"), { textContent: text, hidden: false });
  await loadLayers(note);
  $("message").hidden = true;
  connect();
  reset();
}
// For programs.
window.lumitree = { ready: start().catch(error => { fail(error.message); }) };
