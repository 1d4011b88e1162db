// The content of the page, WebGL 2, and textures of 4096 texels a row.
const content = JSON.parse(document.getElementById("content").textContent);
const shaders = JSON.parse(document.getElementById("shaders").textContent);
const canvas = document.getElementById("view");
const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });

function fail(text) {
  const message = document.getElementById("message");
  message.textContent = text;
  message.hidden = false;
  throw new Error(text);
}
if (!gl) fail("This browser has no WebGL 2, which this page needs.");
if (!gl.getExtension("EXT_color_buffer_float")) fail("This GPU cannot draw to float textures, which this page needs.");
canvas.addEventListener("webglcontextlost", () => fail("The GPU stopped. Reload the page."));

async function unpackArrays() {
  if (typeof DecompressionStream === "undefined") fail("This browser has no DecompressionStream, which this page needs.");
  const packed = Uint8Array.from(atob(content.block), c => c.charCodeAt(0));
  content.block = null;
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const types = { i4: Int32Array, i2: Int16Array, u2: Uint16Array, f4: Float32Array, f2: Uint16Array, u1: Uint8Array };
  const arrays = {};
  let start = 0;
  for (const [name, type, rows, columns, planes] of content.arrays) {
    const size = rows * columns * types[type].BYTES_PER_ELEMENT, part = bytes.slice(start, start + size);
    arrays[name] = planes ? fromPlanes(part, types[type], rows, columns) : new types[type](part.buffer);
    start += size;
  }
  return arrays;
}

// Integers of planes of bytes of the differences between rows (lumitree.asset.array_stream).
function fromPlanes(bytes, type, rows, columns) {
  const found = new type(rows * columns), size = type.BYTES_PER_ELEMENT;
  for (let column = 0; column < columns; ++column) {
    const first = column * size * rows;
    for (let row = 0, value = 0; row < rows; ++row) {
      let code = 0;
      for (let k = 0; k < size; ++k) code |= bytes[first + k * rows + row] << 8 * k;
      value += code >>> 1 ^ -(code & 1);
      found[row * columns + column] = value |= 0;
    }
  }
  return found;
}

function halfToFloat(h) {
  const sign = h & 0x8000 ? -1 : 1, exponent = h >> 10 & 31, mantissa = h & 1023;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + mantissa / 1024) : 2 ** -24 * mantissa);
}

function makeProgram(fragment, defines = "") {
  const head = "#version 300 es\nprecision highp float;precision highp int;precision highp sampler2D;precision highp isampler2D;\n";
  const vertex = "#version 300 es\nvoid main(){gl_Position=vec4(vec2(gl_VertexID&1,gl_VertexID>>1)*4.0-1.0,0,1);}";
  const program = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, head + defines + shaders[fragment]]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) fail(`The shader ${fragment} does not compile: ${gl.getShaderInfoLog(shader)}`);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) fail(`The shader ${fragment} does not link: ${gl.getProgramInfoLog(program)}`);
  const places = {};
  return { program, place: name => places[name] ??= gl.getUniformLocation(program, name) };
}

// A texture of several layers, as a value for `draw`.
class Layers { constructor(texture) { this.texture = texture; } }
const layers = texture => new Layers(texture);

// An array of vectors of three numbers, as a value for `draw`.
class Vectors { constructor(numbers) { this.numbers = numbers; } }
const vectors = numbers => new Vectors(numbers);

// Draws one triangle over the viewport. Values: numbers, arrays, vectors, or textures.
function draw({ program, place }, values) {
  gl.useProgram(program);
  let unit = 0;
  for (const [name, value] of Object.entries(values)) {
    const at = place(name);
    if (value instanceof WebGLTexture || value instanceof Layers) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      if (value instanceof Layers) gl.bindTexture(gl.TEXTURE_2D_ARRAY, value.texture);
      else gl.bindTexture(gl.TEXTURE_2D, value);
      gl.uniform1i(at, unit++);
    } else if (typeof value === "number") gl.uniform1f(at, value);
    else if (value instanceof Vectors) gl.uniform3fv(at, value.numbers);
    else if (value instanceof Int32Array) gl.uniform1iv(at, value);
    else if (value.length === 9) gl.uniformMatrix3fv(at, false, value);
    else gl[`uniform${value.length}fv`](at, value);
  }
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}
const int = (...values) => new Int32Array(values);

function makeTexture(filter = gl.NEAREST) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, filter);
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
  return texture;
}

// A texture of a long array; `channels` numbers of `data` are one texel.
function longTexture(data, channels, internal, format, type) {
  const rows = Math.ceil(data.length / channels / 4096);
  if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) fail("The asset is too large for this GPU.");
  const padded = new data.constructor(rows * 4096 * channels);
  padded.set(data);
  const texture = makeTexture();
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, internal, 4096, rows, 0, format, type, padded);
  return texture;
}

function makeTarget(count, format = gl.RGBA32F, filter = gl.NEAREST) {
  return { buffer: gl.createFramebuffer(), textures: Array.from({ length: count }, () => makeTexture(filter)), width: 0, height: 0, format };
}
function bindTarget(target, width, height) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.buffer);
  if (target.width !== width || target.height !== height) {
    Object.assign(target, { width, height });
    target.textures.forEach((texture, i) => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, target.format, width, height, 0, gl.RGBA, gl.FLOAT, null);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
    });
    gl.drawBuffers(target.textures.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
  }
  gl.viewport(0, 0, width, height);
}
// Values [height][width][4] of a target, bottom row first.
function readTarget(target, attachment = 0, width = target.width, height = target.height) {
  const pixels = new Float32Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.buffer);
  gl.readBuffer(gl.COLOR_ATTACHMENT0 + attachment);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, pixels);
  return pixels;
}
