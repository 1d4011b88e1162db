// Layers of an image: unpacked (lumitree.viewer.dimmers), and summed by the GPU.
const { width, height, lamps } = content, pixels = width * height;
const image = {};

// In place: undoes a step of the wavelet 5/3 along lines, of which values are `along` apart.
function undoLifting(values, count, along, lines, across) {
  if (count < 2) return;
  for (const odd of [0, 1])
    for (let i = odd; i < count; i += 2) {
      const to = i * along, before = (i ? i - 1 : 1) * along, after = (i + 1 < count ? i + 1 : i - 1) * along;
      for (let j = 0, k = 0; j < lines; ++j, k += across)
        values[to + k] += odd ? values[before + k] + values[after + k] >> 1 : -(values[before + k] + values[after + k] + 2 >> 2);
    }
}

// Values [height * width] of a plane of the stream.
function unpackPlane({ low, high }, number, step) {
  const sizes = [[width, height]];
  for (let i = 0; i < content.levels; ++i) sizes.push(sizes[i].map(n => n + 1 >> 1));
  let at = number * pixels, [w, h] = sizes[content.levels], values = new Int32Array(w * h);
  const fill = (y0, x0, apart, factor) => {
    for (let y = y0; y < h; y += apart)
      for (let x = x0; x < w; x += apart) {
        const code = low[at] | high[at++] << 8;
        values[y * w + x] = factor * (code >>> 1 ^ -(code & 1));
      }
  };
  fill(0, 0, 1, 1);
  for (let level = content.levels - 1; level >= 0; --level) {
    const coarse = values, coarseWidth = w;
    [w, h] = sizes[level];
    values = new Int32Array(w * h);
    for (let y = 0; y < h; y += 2) for (let x = 0; x < w; x += 2) values[y * w + x] = coarse[(y >> 1) * coarseWidth + (x >> 1)];
    for (const [y, x] of [[1, 0], [0, 1], [1, 1]]) fill(y, x, 2, Math.max(1, step >> level));
    undoLifting(values, w, 1, h, w);
    undoLifting(values, h, w, w, 1);
  }
  return values;
}
// Codes of G, of R - G and of B - G.
const unpackColour = (arrays, number, steps) => steps.map((step, i) => unpackPlane(arrays, 3 * number + i, step));

function makeLayers(format, count) {
  const kind = gl.TEXTURE_2D_ARRAY, texture = gl.createTexture();
  gl.bindTexture(kind, texture);
  gl.texStorage3D(kind, 1, format, width, height, count);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, side, gl.NEAREST);
  return texture;
}
function fillLayer(texture, number, format, values) {
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
  gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, number, width, height, 1, format, gl.FLOAT, values);
}

async function loadLayers(note) {
  const arrays = await unpackArrays(), count = lamps.length, { unit, least, largest, step, columns } = content;
  const radiance = Float32Array.from({ length: largest + 1 }, (_, u) => Math.min((2 ** (u * unit) - 1) * least, 6e4));
  const of = u => radiance[u < 0 ? 0 : u > largest ? largest : u];
  image.light = makeLayers(gl.RGBA16F, count + 1);
  image.levels = makeLayers(gl.R16F, columns ? count : 1);
  const [tg, tr, tb] = unpackColour(arrays, 0, [1, 1, 1]);
  const sum = new Float32Array(4 * pixels), values = new Float32Array(4 * pixels), levels = new Float32Array(pixels);
  for (let number = 0; number < count; ++number) {
    note(`Unpacking ${number + 1} of ${count} layers`);
    await new Promise(done => setTimeout(done));
    const [g, r, b] = unpackColour(arrays, number + 1, [step, 2 * step, 2 * step]), { column } = lamps[number];
    for (let i = 0; i < pixels; ++i) {
      const green = g[i] + 2 * tg[i], k = 4 * i;
      values[k] = of(green + r[i] + 2 * tr[i]);
      values[k + 1] = of(green);
      values[k + 2] = of(green + b[i] + 2 * tb[i]);
      for (let c = 0; c < 3; ++c) sum[k + c] += values[k + c];
      if (column < 0) { values[k + 3] = 0; continue; }
      const share = arrays.seen[columns * i + column], level = arrays.seen[columns * i + column + 1];
      values[k + 3] = share / 65535;
      levels[i] = share ? Math.min(2 ** (level / 512 - 64), 6e4) : 0;
    }
    fillLayer(image.light, number, gl.RGBA, values);
    if (column >= 0) fillLayer(image.levels, number, gl.RED, levels);
  }
  // The layers add up to the sum, which has smaller errors.
  for (let i = 0; i < pixels; ++i) {
    const k = 4 * i, total = [tg[i] + tr[i], tg[i], tg[i] + tb[i]];
    for (let c = 0; c < 3; ++c) sum[k + c] = sum[k + c] ? of(2 * total[c]) / sum[k + c] : 0;
  }
  fillLayer(image.light, count, gl.RGBA, sum);
  if (gl.getError()) fail("The layers are too large for this GPU.");
  const defines = `#define COUNT ${count}\n`, half = (size, filter) => makeTarget(size, gl.RGBA16F, filter);
  image.sum = makeProgram("sum", defines);
  image.probe = makeProgram("sum", `${defines}#define PROBE\n`);
  image.join = makeProgram("filters", "#define JOIN\n");
  image.halve = makeProgram("filters", "#define HALVE\n");
  image.blur = makeProgram("filters");
  image.photo = makeProgram("photo", shaders.agx);
  image.summed = half(2);
  image.joined = half(1);
  // Each has half the size of the one before; bloom is drawn at the size that suits its width.
  image.smaller = [1, 2, 3, 4].map(() => half(1));
  const diagonal = Math.hypot(width, height);
  image.bloom = content.bloom_widths.map(([part, weight]) => {
    const deviation = part * diagonal, power = Math.min(4, Math.max(1, Math.floor(Math.log2(deviation / 2)))), size = 2 ** power;
    // Halving and linear interpolation widen it, too.
    const left = deviation ** 2 - (size ** 2 - 1) / 12 - size ** 2 / 6;
    return { power, weight, deviation: Math.sqrt(Math.max(left, 0.01)) / size, targets: [half(1), half(1, gl.LINEAR)] };
  });
}

// Draws the photograph to the canvas. `gains`: R, G and B of each layer; `exposure`: a factor.
function drawPhotograph({ gains, exposure, share, adaptation, clip }) {
  const most = content.most;
  bindTarget(image.summed, width, height);
  draw(image.sum, { light: layers(image.light), levels: layers(image.levels), "gain[0]": vectors(gains), exposure, most, has_levels: int(content.columns ? 1 : 0) });
  bindTarget(image.joined, width, height);
  draw(image.join, { image: image.summed.textures[0], clamped: image.summed.textures[1], most, deviation: content.filter });
  let source = image.joined;
  for (const target of image.smaller) {
    bindTarget(target, source.width + 1 >> 1, source.height + 1 >> 1);
    draw(image.halve, { image: source.textures[0] });
    source = target;
  }
  image.bloom.forEach(({ power, deviation, targets }) => {
    let source = image.smaller[power - 1];
    targets.forEach((target, i) => {
      bindTarget(target, source.width, source.height);
      draw(image.blur, { image: source.textures[0], deviation, axis: [1 - i, i] });
      source = target;
    });
  });
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, width, height);
  const values = { image: image.joined.textures[0], weights: image.bloom.map(each => each.weight), share, adaptation, clip: int(clip ? 1 : 0) };
  image.bloom.forEach(({ power, targets: [, { textures, width: w, height: h }] }, i) => {
    values[`bloom${i}`] = textures[0];
    values[`scale${i}`] = [1 / (w << power), 1 / (h << power)];
  });
  draw(image.photo, values);
}

// Luminance of each layer, with its gain, around a pixel.
function probe(gains, x, y) {
  image.probed ??= makeTarget(1);
  bindTarget(image.probed, lamps.length, 1);
  draw(image.probe, { light: layers(image.light), "gain[0]": vectors(gains), pointer: [x, y] });
  const found = readTarget(image.probed);
  return lamps.map((_, i) => 0.2126 * found[4 * i] + 0.7152 * found[4 * i + 1] + 0.0722 * found[4 * i + 2]);
}
