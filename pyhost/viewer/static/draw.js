// Draws the map and the spheres with WebGL: changes of exposure, tone, wipe and false colour need no server.

const TONE = `
uniform float exposure, gamma;
uniform bool soft;
vec3 shown(vec3 radiance) {
  vec3 c = max(radiance * exposure, 0.0);
  if (soft) c = c / (1.0 + c);
  return pow(clamp(c, 0.0, 1.0), vec3(1.0 / gamma));
}`;
const HEAD = "#version 300 es\nprecision highp float;\nprecision highp sampler2D;\n";
const SQUARE = `${HEAD}out vec2 uv;
void main() { uv = vec2(gl_VertexID & 1, gl_VertexID >> 1); gl_Position = vec4(2.0 * uv - 1.0, 0.0, 1.0); }`;

const MAP = `${HEAD}${TONE}
in vec2 uv;
uniform sampler2D map, outlines;
uniform float scale;
uniform bool outlined;
uniform mat3 back;  // from a turned direction to the direction in the file
out vec4 colour;
const float PI = 3.14159265358979;
void main() {
  float theta = PI * (1.0 - uv.y), phi = 2.0 * PI * uv.x;
  vec3 d = back * vec3(sin(theta) * cos(phi), cos(theta), sin(theta) * sin(phi));
  vec2 at = vec2(atan(d.z, d.x) / (2.0 * PI), acos(clamp(d.y, -1.0, 1.0)) / PI);
  colour = vec4(shown(textureLod(map, at, 0.0).rgb * scale), 1.0);
  if (outlined) {
    float edge = textureLod(outlines, at, 0.0).r;
    colour.rgb = mix(mix(colour.rgb, vec3(0.0), smoothstep(0.1, 0.4, edge)), vec3(1.0), smoothstep(0.6, 0.9, edge));
  }
}`;

const MARKS = `${HEAD}
layout(location = 0) in vec3 direction;
layout(location = 1) in float size;
uniform mat3 turn;
uniform float unit;
flat out float pixels;
const float PI = 3.14159265358979;
void main() {
  vec3 d = turn * direction;
  vec2 at = vec2(atan(d.z, d.x) / PI, 1.0 - 2.0 * acos(clamp(d.y, -1.0, 1.0)) / PI);
  at.x = at.x < 0.0 ? at.x + 1.0 : at.x - 1.0;  // phi from 0 to 2 pi, as -1 to 1
  gl_Position = vec4(at.x + 2.0 * float(gl_InstanceID - 1), at.y, 0.0, 1.0);  // drawn again one map width to the left and right
  pixels = clamp(unit * size, 0.5 * unit, 4.0 * unit) + 3.0;
  gl_PointSize = pixels;
}`;
const MARK = `${HEAD}
flat in float pixels;
out vec4 colour;
void main() {
  float r = length(gl_PointCoord - 0.5) * pixels, outer = 0.5 * pixels;
  if (r > outer) discard;
  float ring = max(1.2, 0.22 * pixels);
  vec3 inside = vec3(0.0, 0.447, 0.698);
  colour = vec4(r > outer - 1.2 ? vec3(0.0) : r > outer - 1.2 - ring ? vec3(1.0) : inside, 1.0);
  colour.a = clamp(outer - r, 0.0, 1.0);
  colour.rgb *= colour.a;
}`;

const SPHERE = `${HEAD}${TONE}
in vec2 uv;
uniform sampler2D image, reference;
uniform float image_scale, reference_scale, wipe, difference, pixels;
uniform int kind;  // 0: the image, wiped to the exact one; 1: the exact image; 2: their difference
uniform vec3 neutral;
uniform bool turned;  // the reference is six images of the sphere, one per side, to be looked up through back
uniform mat3 back;
out vec4 colour;
// The six images lie side by side; they show the sphere with +z, -z, +x, -x, +y and -y in front.
vec2 in_six(vec3 d) {
  vec3 size = abs(d), n = vec3(d.x, d.y, 0.0);
  if (size.z >= size.x && size.z >= size.y) { if (d.z < 0.0) n = vec3(-d.x, d.y, 1.0); }
  else if (size.x >= size.y) n = d.x > 0.0 ? vec3(-d.z, d.y, 2.0) : vec3(d.z, d.y, 3.0);
  else n = d.y > 0.0 ? vec3(d.x, -d.z, 4.0) : vec3(d.x, d.z, 5.0);
  return vec2((n.z + 0.5 + 0.5 * n.x) / 6.0, 0.5 - 0.5 * n.y);
}
void main() {
  vec2 middle = uv - 0.5, pixel = 1.0 / vec2(textureSize(image, 0));  // beyond the rim is black: stay inside it
  middle *= min(1.0, (0.5 - 1.5 * pixel.x) / max(length(middle), 1e-6));
  vec2 at = vec2(0.5 + middle.x, 0.5 - middle.y);
  vec3 a = texture(image, at).rgb * image_scale, b;
  if (turned) {
    vec2 n = 2.0 * uv - 1.0;
    b = texture(reference, in_six(back * vec3(n, sqrt(max(0.0, 1.0 - dot(n, n)))))).rgb * reference_scale;
  } else b = texture(reference, at).rgb * reference_scale;
  vec3 c;
  if (kind == 2) {
    float d = clamp(dot(a - b, vec3(1.0 / 3.0)) / difference, -1.0, 1.0);
    c = mix(neutral, d < 0.0 ? vec3(0.0, 0.447, 0.698) : vec3(0.835, 0.369, 0.0), abs(d));
  } else c = shown(kind == 1 || uv.x > wipe ? b : a);
  if (kind == 0 && wipe < 1.0 && abs(uv.x - wipe) * pixels < 1.0) c = vec3(1.0, 0.85, 0.2);
  float inside = clamp((0.5 - length(uv - 0.5)) * pixels + 0.5, 0.0, 1.0);
  colour = vec4(c * inside, inside);
}`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "a shader does not link");
  const at = new Map();
  return { use: () => gl.useProgram(made), at: (name) => at.get(name) ?? (at.set(name, gl.getUniformLocation(made, name)), at.get(name)) };
}

function context(canvas) {
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: true, preserveDrawingBuffer: true, powerPreference: "high-performance" });
  if (!gl) return null;
  gl.smooth = gl.getExtension("OES_texture_float_linear") !== null;
  const { UNMASKED_RENDERER_WEBGL: name = gl.RENDERER } = gl.getExtension("WEBGL_debug_renderer_info") ?? {};
  gl.inSoftware = /swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(name));
  return gl;
}

/** Gives a canvas the resolution it has on the screen, times `share` in each direction. */
function fit(canvas, share = 1) {
  const ratio = share * Math.min(2, window.devicePixelRatio || 1);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width === width && canvas.height === height) return;
  canvas.width = width;
  canvas.height = height;
}

/** A texture for an array of an answer: { shape, type, data, scale }. */
class Texture {
  constructor(gl, wrap) {
    this.gl = gl;
    this.wrap = wrap;
    this.scale = 0;
    this.key = "";
    this.put({ shape: [1, 1, 3], type: "float32", data: new Float32Array(3), scale: 1 });
  }

  put({ shape: [height, width], type, data, scale }) {
    const gl = this.gl, half = type === "float16", key = `${width} ${height} ${type}`;
    if (key !== this.key) {
      if (this.texture) gl.deleteTexture(this.texture);
      this.texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, this.texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, half ? gl.RGB16F : gl.RGB32F, width, height);
      const filter = half || gl.smooth ? gl.LINEAR : gl.NEAREST;
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, this.wrap);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      this.key = key;
    } else gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGB, half ? gl.HALF_FLOAT : gl.FLOAT, data);
    this.scale = scale;
    this.array = { data, scale };
  }

  bind(unit) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, this.texture);
    this.gl.activeTexture(this.gl.TEXTURE0);
  }
}

function setTone(gl, used, { exposure, gamma, soft }) {
  gl.uniform1f(used.at("exposure"), exposure);
  gl.uniform1f(used.at("gamma"), gamma);
  gl.uniform1i(used.at("soft"), soft ? 1 : 0);
}

/** The latitude-longitude map, turned, with marks where the lights are. */
export class MapView {
  constructor(canvas) {
    const gl = context(canvas);
    if (!gl) throw new Error("no WebGL 2");
    Object.assign(this, { canvas, gl, count: 0, outlined: false });
    this.map = new Texture(gl, gl.REPEAT);
    this.forMap = program(gl, SQUARE, MAP);
    this.forMarks = program(gl, MARKS, MARK);
    this.outlines = gl.createTexture();
    this.direction = gl.createBuffer();
    this.size = gl.createBuffer();
    this.empty = gl.createVertexArray();
    this.marks = gl.createVertexArray();
    gl.bindVertexArray(this.marks);
    for (const [place, buffer, length] of [[0, this.direction, 3], [1, this.size, 1]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, length, gl.FLOAT, false, 0, 0);
    }
    gl.bindVertexArray(null);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  putMarks(direction, size) {
    const gl = this.gl;
    this.count = size.length;
    for (const [buffer, data] of [[this.direction, direction], [this.size, size]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    }
  }

  /** Draws the outlines of regions (x0, y0, x1, y1) of a width x height map into a texture: white lines on black. */
  putRegions(regions, width, height) {
    const gl = this.gl;
    this.outlined = regions.length > 0;
    if (!this.outlined) return;
    const W = 2048, H = 1024, lines = new Uint8Array(W * H);
    const line = (from, to, place, across, value, side) => {
      for (let i = from; i <= to; i++) for (const j of side) {
        const x = across ? i : place + j, y = across ? place + j : i;
        if (y < 0 || y >= H) continue;
        const at = y * W + ((x % W) + W) % W;
        lines[at] = Math.max(lines[at], value);
      }
    };
    for (const [value, side] of [[128, [-4, -3, -2, -1, 0, 1, 2, 3]], [255, [-2, -1, 0, 1]]]) for (let n = 0; n < regions.length; n += 4) {
      const x0 = Math.round((regions[n] * W) / width), y0 = Math.round((regions[n + 1] * H) / height);
      const x1 = Math.round((regions[n + 2] * W) / width), y1 = Math.round((regions[n + 3] * H) / height);
      line(x0, x1, y0, true, value, side);
      line(x0, x1, y1, true, value, side);
      line(y0, y1, x0, false, value, side);
      line(y0, y1, x1, false, value, side);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.outlines);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, W, H, 0, gl.RED, gl.UNSIGNED_BYTE, lines);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.REPEAT);
  }

  /** Without a GPU, a moving map is drawn more coarsely: drawing it takes longer than shading the sphere. */
  draw(matrix, tone, showMarks, isMoving) {
    const { gl, canvas } = this;
    fit(canvas, isMoving && gl.inSoftware ? 0.6 : 1);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(this.empty);
    const { forMap, forMarks } = this;
    forMap.use();
    this.map.bind(0);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.outlines);
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(forMap.at("map"), 0);
    gl.uniform1i(forMap.at("outlines"), 1);
    gl.uniform1i(forMap.at("outlined"), this.outlined && showMarks ? 1 : 0);
    gl.uniform1f(forMap.at("scale"), this.map.scale);
    gl.uniformMatrix3fv(forMap.at("back"), true, transposed(matrix).flat());
    setTone(gl, forMap, tone);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    if (!showMarks || !this.count) return;
    gl.enable(gl.BLEND);
    gl.bindVertexArray(this.marks);
    forMarks.use();
    gl.uniformMatrix3fv(forMarks.at("turn"), true, matrix.flat());
    gl.uniform1f(forMarks.at("unit"), (canvas.width / canvas.clientWidth || 1) * Math.max(0.5, 22 * this.count ** -0.22));
    gl.drawArraysInstanced(gl.POINTS, 0, this.count, 3);
  }
}

const transposed = (m) => [0, 1, 2].map((i) => m.map((row) => row[i]));

/** Three spheres, in a row or with the first on top: the method's, wiped to the exact one; the exact; the difference. */
export class SphereView {
  constructor(canvas) {
    const gl = context(canvas);
    if (!gl) throw new Error("no WebGL 2");
    Object.assign(this, { canvas, gl });
    this.image = new Texture(gl, gl.CLAMP_TO_EDGE);
    this.reference = new Texture(gl, gl.CLAMP_TO_EDGE);
    this.six = new Texture(gl, gl.CLAMP_TO_EDGE);
    this.forSphere = program(gl, SQUARE, SPHERE);
    this.empty = gl.createVertexArray();
  }

  /** The squares of the three pictures: x and y from the canvas's lower left corner, and the side, in pixels. */
  places() {
    const { width, height } = this.canvas;
    if (width > 2 * height) {
      const gap = Math.round(0.02 * width), side = Math.min(height, Math.floor((width - 2 * gap) / 3));
      return [0, 1, 2].map((n) => [n * (side + gap), height - side, side]);
    }
    const small = Math.floor(0.48 * width);
    return [[0, height - width, width], [0, 0, small], [width - small, 0, small]];
  }

  /** `turn` is the rotation of the approximate exact image, or null if the exact image is there. */
  draw({ wipe, difference, albedo, neutral, tone, turn = null }) {
    const { gl, canvas, forSphere } = this;
    fit(canvas);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.bindVertexArray(this.empty);
    forSphere.use();
    const reference = turn ? this.six : this.reference;
    this.image.bind(0);
    reference.bind(1);
    gl.uniform1i(forSphere.at("turned"), turn ? 1 : 0);
    if (turn) gl.uniformMatrix3fv(forSphere.at("back"), true, transposed(turn).flat());
    gl.uniform1i(forSphere.at("image"), 0);
    gl.uniform1i(forSphere.at("reference"), 1);
    gl.uniform1f(forSphere.at("image_scale"), this.image.scale);
    gl.uniform1f(forSphere.at("reference_scale"), reference.scale * albedo);
    gl.uniform1f(forSphere.at("wipe"), wipe);
    gl.uniform1f(forSphere.at("difference"), difference);
    gl.uniform3fv(forSphere.at("neutral"), neutral);
    setTone(gl, forSphere, tone);
    this.places().forEach(([x, y, side], kind) => {
      gl.viewport(x, y, side, side);
      gl.uniform1i(forSphere.at("kind"), kind);
      gl.uniform1f(forSphere.at("pixels"), side);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
  }
}
