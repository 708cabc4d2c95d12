/* Draws models with WebGL2. A view is {pose, fx, fy, cx, cy, width, height, detail}: pixels of the
   target, and detail: how many of them to a pixel of the photos, along a side. */

const COLOUR = 0, DEPTH = 1, COUNT = 2;
const DILATION = 0.3, PIXEL_VARIANCE = 1 / 12; // pixels^2: framework/kernels/constants.py; of a box
const TEXELS = 3; // of a projected Gaussian
const CHUNK = 1024; // Gaussians that are drawn as one instance: one each is slow on many a driver
const MOST_COUNT = 1023; // of the colours of the count view
const UNCHANGED = [1, 1, 1]; // factors of colours

class Renderer {
  constructor(canvas) {
    const wanted = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    const gl = this.gl = canvas.getContext("webgl2", wanted);
    if (!gl) throw new Error("This browser has no WebGL2; another one, or switched-on graphics acceleration, shows the splat.");
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
      throw new Error("This graphics driver cannot blend half floats, which the splat needs.");
    }
    this.project = this.program(PROJECT, "#version 300 es\nprecision highp float; out vec4 unused; void main() { unused = vec4(0.0); }", ["place", "shape", "colour"]);
    this.blend = this.program(SPLAT, BLEND);
    this.resolve = this.program(COVER, RESOLVE);
    this.feedback = gl.createTransformFeedback();
    this.nothing = gl.createVertexArray();
    this.quads = gl.createVertexArray();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    const corners = Uint16Array.from({ length: 6 * CHUNK }, (_, i) => 4 * Math.floor(i / 6) + [0, 1, 2, 2, 1, 3][i % 6]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.range = [1, 10];
    this.sums = new Map();
  }

  program(vertex, fragment, captured) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    }
    if (captured) gl.transformFeedbackVaryings(program, captured, gl.INTERLEAVED_ATTRIBS);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(program, i).name.replace("[0]", "");
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places, attribute: (name) => gl.getAttribLocation(program, name) };
  }

  texture(data, texels, width, inner, format, kind) {
    const gl = this.gl, texture = gl.createTexture(), height = Math.max(1, Math.ceil(texels / width));
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texStorage2D(gl.TEXTURE_2D, 1, inner, width, height);
    if (data.length) {
      const padded = new data.constructor(data.length / texels * width * height);
      padded.set(data);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, format, kind, padded);
    }
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return texture;
  }

  /* The model with what the graphics card keeps of it. */
  load(model) {
    const gl = this.gl, width = Math.min(4096, gl.getParameter(gl.MAX_TEXTURE_SIZE));
    model.splats = this.texture(model.table, 4 * model.n, width, gl.RGBA32F, gl.RGBA, gl.FLOAT);
    model.harmonics = this.texture(model.bands, model.rest * model.banded, width, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE);
    model.width = width;
    model.table = model.bands = null;
    model.ids = gl.createBuffer();
    model.perRow = Math.floor(width / TEXELS);
    model.rows = Math.max(1, Math.ceil(model.n / model.perRow));
    model.projected = this.texture(new Float32Array(0), TEXELS * model.perRow * model.rows, TEXELS * model.perRow, gl.RGBA32F, gl.RGBA, gl.FLOAT);
    model.captured = gl.createBuffer();
    gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, model.captured);
    gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, 16 * TEXELS * model.perRow * model.rows, gl.DYNAMIC_COPY);
    gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, null);
    model.input = gl.createVertexArray();
    gl.bindVertexArray(model.input);
    gl.bindBuffer(gl.ARRAY_BUFFER, model.ids);
    gl.bufferData(gl.ARRAY_BUFFER, 4 * Math.max(1, model.n), gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(this.project.attribute("index"));
    gl.vertexAttribIPointer(this.project.attribute("index"), 1, gl.UNSIGNED_INT, 0, 0);
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
    return model;
  }

  /* A target that can be summed into, kept under a key. */
  target(key, width, height, inner) {
    const gl = this.gl;
    let kept = this.sums.get(key);
    if (!kept || kept.width !== width || kept.height !== height) {
      if (kept) gl.deleteTexture(kept.texture);
      const frame = kept ? kept.frame : gl.createFramebuffer(), texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, inner, width, height);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
      for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      kept = { frame, texture, width, height };
      this.sums.set(key, kept);
    }
    return kept;
  }

  /* Sums of what a view sees of a model, in the target that is returned. part: [first, last] column. */
  sum(model, view, mode, key, part = [0, view.width]) {
    const gl = this.gl, target = this.target(key, view.width, view.height, gl.RGBA16F);
    const pose = JSON.stringify(view.pose);
    if (model.sorted !== pose) {
      const ids = farthestFirst(model, view.pose);
      gl.bindBuffer(gl.ARRAY_BUFFER, model.ids);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, ids);
      gl.bindBuffer(gl.ARRAY_BUFFER, null);
      model.sorted = pose;
      model.count = ids.length;
    }
    this.toScreen(model, view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.viewport(0, 0, view.width, view.height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(part[0], 0, Math.max(0, part[1] - part[0]), view.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const at = this.blend.places;
    gl.useProgram(this.blend.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, model.projected);
    gl.uniform1i(at.projected, 0);
    gl.uniform1i(at.chunk, CHUNK);
    gl.uniform1i(at.perRow, model.perRow);
    gl.uniform1i(at.count, model.count);
    gl.uniform2f(at.size, view.width, view.height);
    gl.uniform1i(at.mode, mode);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, mode === COUNT ? gl.ONE : gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.quads);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * CHUNK, gl.UNSIGNED_SHORT, 0, Math.ceil(model.count / CHUNK));
    gl.bindVertexArray(null);
    gl.disable(gl.BLEND);
    gl.disable(gl.SCISSOR_TEST);
    return target;
  }

  toScreen(model, view) {
    const gl = this.gl, at = this.project.places, s = view.detail ** 2;
    gl.useProgram(this.project.program);
    [model.splats, model.harmonics].forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.uniform1i(at.splats, 0);
    gl.uniform1i(at.bands, 1);
    gl.uniformMatrix3fv(at.rotation, true, view.pose.R);
    gl.uniform3fv(at.shift, times(view.pose.R, view.pose.c).map((v) => -v));
    gl.uniform3fv(at.eye, view.pose.c);
    gl.uniform3fv(at.ranges, model.ranges);
    gl.uniform4f(at.lens, view.fx, view.fy, view.cx, view.cy);
    gl.uniform2f(at.size, view.width, view.height);
    gl.uniform1f(at.dilation, DILATION * s);
    gl.uniform1f(at.softness, Math.max(0, PIXEL_VARIANCE * (1 - s)));
    gl.uniform1i(at.rest, model.rest);
    gl.uniform1i(at.banded, model.banded);
    gl.uniform1i(at.splatsPerRow, model.width / 4);
    gl.uniform1i(at.bandsPerRow, model.width);
    gl.bindVertexArray(model.input);
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, this.feedback);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, model.captured);
    gl.enable(gl.RASTERIZER_DISCARD);
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, model.count);
    gl.endTransformFeedback();
    gl.disable(gl.RASTERIZER_DISCARD);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, model.captured); // from the buffer to a texture, on the card
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, model.projected);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXELS * model.perRow, Math.ceil(model.count / model.perRow), gl.RGBA, gl.FLOAT, 0);
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
  }

  /* Sums as colours, into a region [x, y, width, height] (from the bottom) of a frame, or the canvas
     (null); only its columns `part`. exposure: factors of the colours, as the photo there was taken. */
  show(target, model, mode, frame, region, part = [0, region[2]], exposure = UNCHANGED) {
    const gl = this.gl, at = this.resolve.places;
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(...region);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(region[0] + part[0], region[1], Math.max(0, part[1] - part[0]), region[3]);
    gl.useProgram(this.resolve.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    gl.uniform1i(at.sums, 0);
    gl.uniform1i(at.mode, mode);
    gl.uniform1i(at.exact, target.width === region[2] && target.height === region[3] ? 1 : 0);
    gl.uniform3fv(at.background, model.background);
    gl.uniform3fv(at.exposure, exposure);
    gl.uniform4f(at.region, ...region);
    gl.uniform2f(at.range, ...(mode === COUNT ? [0, MOST_COUNT] : this.range));
    gl.uniform3fv(at.ramp, RAMP.flatMap((hex) => [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255)));
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindVertexArray(null);
    gl.disable(gl.SCISSOR_TEST);
  }

  /* The picture of a view as ImageData, at its own size. */
  picture(model, view, mode, exposure = UNCHANGED) {
    const gl = this.gl, { width, height } = view;
    const sums = this.sum(model, view, mode, "picture"), made = this.target("pixels", width, height, gl.RGBA8);
    this.show(sums, model, mode, made.frame, [0, 0, width, height], [0, width], exposure);
    const upsideDown = new Uint8Array(4 * width * height), picture = new ImageData(width, height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upsideDown);
    for (let y = 0; y < height; y++) {
      picture.data.set(upsideDown.subarray(4 * width * (height - 1 - y), 4 * width * (height - y)), 4 * width * y);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return picture;
  }

  /* The four sums at a pixel (from the top left) of a kept target. */
  read(key, x, y) {
    const gl = this.gl, kept = this.sums.get(key), value = new Float32Array(4);
    if (!kept) return value;
    gl.bindFramebuffer(gl.FRAMEBUFFER, kept.frame);
    gl.readPixels(Math.floor(x * kept.width), kept.height - 1 - Math.floor(y * kept.height), 1, 1, gl.RGBA, gl.FLOAT, value);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return value;
  }
}
