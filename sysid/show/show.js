"use strict";
/* The view of a rig that turns and plays. Everything is in the page: a table of contents (#head) and a deflated block of
   integers (#block). WebGL 2 draws surfaces and markers, a canvas over it lines and words. */
(async () => {
  const $ = (id) => document.getElementById(id);
  const head = JSON.parse($("head").textContent);
  const failed = (text) => { const d = document.createElement("div"); d.className = "failed"; d.textContent = text; $("stage").append(d); };
  const packed = Uint8Array.from(atob($("block").textContent), (c) => c.charCodeAt(0));
  if (typeof DecompressionStream === "undefined") return failed("This browser is too old to unpack the page. The picture next to it shows the same.");
  const raw = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  const kinds = { uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array };
  const read = (e) => new kinds[e.type](raw, e.at, e.count);
  const count = head.times.length;

  // States of coordinates, summed up from their differences, as Float32 [m] about the centre.
  const unpack = (e) => {
    const whole = read(e), size = whole.length / e.states, states = [], sum = new Int32Array(size);
    for (let k = 0; k < e.states; k++) {
      const out = new Float32Array(size);
      for (let i = 0; i < size; i++) { sum[i] += whole[k * size + i]; if (sum[i] > 32767) sum[i] -= 65536; if (sum[i] < -32768) sum[i] += 65536; out[i] = sum[i] * head.unit; }
      states.push(out);
    }
    return states;
  };
  const at = (states, k) => states[Math.min(k, states.length - 1)];

  // ---- vectors
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]], add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const l = Math.hypot(...a) || 1; return a.map((v) => v / l); };
  const turned = (v, axis, angle) => { const c = Math.cos(angle), s = Math.sin(angle), k = dot(axis, v) * (1 - c), w = cross(axis, v); return v.map((x, i) => x * c + w[i] * s + axis[i] * k); };
  const local = (p) => sub(p, head.centre);

  // ---- WebGL
  const canvas = $("gl"), gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: false, preserveDrawingBuffer: true });
  if (!gl) return failed("This browser has no WebGL 2. The picture next to this page shows the same.");
  const program = (vertex, fragment) => {
    const p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const s = gl.createShader(kind); gl.shaderSource(s, "#version 300 es\nprecision highp float;\n" + text); gl.compileShader(s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
      gl.attachShader(p, s);
    }
    gl.bindAttribLocation(p, 0, "place"); gl.bindAttribLocation(p, 1, "normal"); gl.bindAttribLocation(p, 2, "share"); gl.bindAttribLocation(p, 3, "flag");
    gl.linkProgram(p);
    return new Proxy({ p }, { get: (t, n) => (n === "p" ? t.p : (t[n] ??= gl.getUniformLocation(t.p, n))) });
  };
  const surface = program(`
    in vec3 place; in vec3 normal; in float share; in float flag; uniform mat4 clip; uniform vec3 eye, ahead; uniform float parallel;
    out vec3 n, v, at; out float s; flat out float f;
    void main() { n = normal; at = place; v = parallel > 0.5 ? -ahead : eye - place; s = share; f = flag; gl_Position = clip * vec4(place, 1.0); }`, `
    in vec3 n, v, at; in float s; flat in float f; uniform vec3 colour, key; uniform float alpha, valued, chequered, lamp, sharp; uniform sampler2D map; out vec4 o;
    void main() {
      vec3 flatNormal = normalize(cross(dFdx(at), dFdy(at))), look = normalize(v), m = normalize(n);
      if (dot(flatNormal, look) < 0.0) flatNormal = -flatNormal;
      if (dot(m, look) < 0.0 && dot(m, flatNormal) < 0.0) m = -m;
      if (sharp > 0.5 || dot(m, flatNormal) < 0.77) m = flatNormal;
      vec3 c = colour;
      if (valued > 0.5) c = s > 0.9985 ? vec3(0.72, 0.75, 0.79) : texture(map, vec2(s * 1.0039, 0.5)).rgb;
      else if (f > 1.5) c = vec3(0.76, 0.255, 0.047); else if (f > 0.5) c = mix(c, vec3(0.06, 0.46, 0.43), 0.55);
      if (chequered > 0.0) { vec3 cell = floor(at / chequered + 1e-4); float odd = mod(cell.x + cell.y + cell.z, 2.0); c *= 1.0 - 0.05 * odd; }
      float side = max(dot(m, key), 0.0), front = max(dot(m, look), 0.0), lit = 0.60 + 0.28 * side + 0.22 * front;
      o = vec4(c * (1.0 + lamp * (lit - 0.95)) + 0.06 * lamp * pow(side, 24.0), alpha);
    }`);
  const lines = program("in vec3 place; uniform mat4 clip; void main() { gl_Position = clip * vec4(place, 1.0); }", "uniform vec4 colour; out vec4 o; void main() { o = colour; }");
  const dots = program("in vec3 place; uniform mat4 clip; uniform float size; void main() { gl_Position = clip * vec4(place, 1.0); gl_PointSize = size; }",
    "uniform vec4 colour; out vec4 o; void main() { float r = length(gl_PointCoord - 0.5); if (r > 0.5) discard; o = vec4(colour.rgb, colour.a * smoothstep(0.5, 0.4, r)); }");
  const map = gl.createTexture(), table = head.colours, width = table.length / 3;
  gl.bindTexture(gl.TEXTURE_2D, map);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, width, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(table));
  for (const [k, v] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, k, v);
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

  const bodies = head.bodies.map((b) => {
    const triangles = read(b.triangles), bonded = read(b.bonded), free = [], edges = new Set();
    for (let t = 0; t < bonded.length; t++) {
      const c = [triangles[3 * t], triangles[3 * t + 1], triangles[3 * t + 2]];
      if (!bonded[t]) free.push(...c);
      for (let k = 0; k < 3; k++) { const i = c[k], j = c[(k + 1) % 3]; edges.add(i < j ? i * 65536 + j : j * 65536 + i); }
    }
    const pairs = new Uint16Array(2 * edges.size); let e = 0;
    for (const id of edges) { pairs[e++] = Math.floor(id / 65536); pairs[e++] = id % 65536; }
    const index = (data) => { const h = gl.createBuffer(); gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, h); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, data, gl.STATIC_DRAW); return { h, n: data.length }; };
    const flags = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, flags); gl.bufferData(gl.ARRAY_BUFFER, read(b.flags), gl.STATIC_DRAW);
    const values = {}; for (const q in b.values) values[q] = read(b.values[q]);
    return { ...b, triangles, states: unpack(b.positions), values, colour: rgb(b.colour), shown: true, all: index(triangles), free: index(new Uint16Array(free)), edges: index(pairs),
      place: gl.createBuffer(), normal: gl.createBuffer(), share: gl.createBuffer(), flags, soft: b.kind === "gel" || b.kind === "sheet" };
  });
  for (const group of [head.markers, head.cameras, head.sought]) for (const n in group) group[n].states = unpack(group[n].points ?? group[n]);
  const dotBuffer = gl.createBuffer();

  // ---- state of the page
  const extent = Math.max(...sub(head.high, head.low)), middle = local(add(head.low, head.high).map((v) => v / 2));
  const view = {}, home = { target: middle, ahead: unit(head.towards), up: head.up, distance: extent * 1.9 };
  const reset = () => Object.assign(view, { ...home, target: [...home.target] });
  reset();
  let step = 0, quantity = head.first, playing = false, dirty = true, loaded = -1, loadedQuantity = null;
  $("quantity").value = quantity;
  const wanted = new Proxy({}, { get: (_, id) => $(id).checked });

  const upload = () => {
    if (loaded === step && loadedQuantity === quantity) return;
    for (const b of bodies) {
      const p = at(b.states, step), n = new Float32Array(p.length), t = b.triangles;
      for (let k = 0; k < t.length; k += 3) {
        const i = 3 * t[k], j = 3 * t[k + 1], l = 3 * t[k + 2];
        const ux = p[j] - p[i], uy = p[j + 1] - p[i + 1], uz = p[j + 2] - p[i + 2], vx = p[l] - p[i], vy = p[l + 1] - p[i + 1], vz = p[l + 2] - p[i + 2];
        const x = 1e6 * (uy * vz - uz * vy), y = 1e6 * (uz * vx - ux * vz), z = 1e6 * (ux * vy - uy * vx);
        for (const a of [i, j, l]) { n[a] += x; n[a + 1] += y; n[a + 2] += z; }
      }
      for (const [h, data] of [[b.place, p], [b.normal, n]]) { gl.bindBuffer(gl.ARRAY_BUFFER, h); gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW); }
      const values = b.values[quantity], size = p.length / 3;
      gl.bindBuffer(gl.ARRAY_BUFFER, b.share);
      gl.bufferData(gl.ARRAY_BUFFER, values ? values.subarray(step * size, (step + 1) * size) : new Uint8Array(size), gl.DYNAMIC_DRAW);
    }
    loaded = step; loadedQuantity = quantity;
  };

  // Column-major matrices. Axes: right, down, forward of a camera.
  const clipOf = (eye, axes, fx, fy, cx, cy, w, h, near, far, parallel) => {
    const [r, d, f] = axes, a = [2 * fx / w, 0, 2 * cx / w - 1], b = [0, 2 * fy / h, 2 * cy / h - 1];
    const row = (u) => [...u, -dot(u, eye)];
    const R = row(r), D = row(d), F = row(f), out = [];
    const X = parallel ? R.map((v, i) => a[0] * v + (i === 3 ? a[2] : 0)) : R.map((v, i) => a[0] * v + a[2] * F[i]);
    const Y = parallel ? D.map((v, i) => -b[1] * v - (i === 3 ? b[2] : 0)) : D.map((v, i) => -b[1] * v - b[2] * F[i]);
    const Z = parallel ? F.map((v, i) => 2 * v / (far - near) - (i === 3 ? (far + near) / (far - near) : 0)) : F.map((v, i) => (far + near) / (far - near) * v - (i === 3 ? 2 * far * near / (far - near) : 0));
    const W = parallel ? [0, 0, 0, 1] : F;
    for (let i = 0; i < 4; i++) out.push(X[i], Y[i], Z[i], W[i]);
    return new Float32Array(out);
  };
  const axesOf = (ahead, up) => { const r = unit(cross(ahead, up)); return [r, cross(ahead, r), ahead]; };

  const drawScene = (clip, eye, axes, parallel, mount, pixels) => {
    const ghostly = quantity !== "" && mount === null;
    gl.useProgram(surface.p);
    gl.uniformMatrix4fv(surface.clip, false, clip); gl.uniform3fv(surface.eye, eye); gl.uniform3fv(surface.ahead, axes[2]); gl.uniform1f(surface.parallel, parallel ? 1 : 0);
    gl.uniform3fv(surface.key, unit(axes[2].map((v, i) => -0.55 * v - 0.62 * axes[1][i] - 0.55 * axes[0][i])));
    gl.enable(gl.DEPTH_TEST); gl.enable(gl.BLEND); gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const paint = (b, alpha, index) => {
      gl.useProgram(surface.p);
      const valued = quantity !== "" && b.kind !== "rigid" && b.kind !== "plane";
      gl.uniform3fv(surface.colour, b.colour); gl.uniform1f(surface.alpha, alpha); gl.uniform1f(surface.valued, valued ? 1 : 0); gl.uniform1f(surface.sharp, b.sharp ? 1 : 0);
      gl.uniform1f(surface.chequered, b.kind === "plane" ? extent / 8 : 0); gl.uniform1f(surface.lamp, b.kind === "plane" ? 0.3 : 1);
      for (const [slot, h, size, type, norm] of [[0, b.place, 3, gl.FLOAT, false], [1, b.normal, 3, gl.FLOAT, false], [2, b.share, 1, gl.UNSIGNED_BYTE, true], [3, b.flags, 1, gl.UNSIGNED_BYTE, false]]) {
        gl.bindBuffer(gl.ARRAY_BUFFER, h); gl.enableVertexAttribArray(slot); gl.vertexAttribPointer(slot, size, type, norm, 0, 0);
      }
      gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(1, 1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index.h); gl.drawElements(gl.TRIANGLES, index.n, gl.UNSIGNED_SHORT, 0);
      gl.disable(gl.POLYGON_OFFSET_FILL);
      if (b.soft && wanted.mesh) {
        for (const slot of [1, 2, 3]) gl.disableVertexAttribArray(slot);
        gl.useProgram(lines.p); gl.uniformMatrix4fv(lines.clip, false, clip); gl.uniform4f(lines.colour, 0, 0, 0, 0.16);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, b.edges.h); gl.drawElements(gl.LINES, b.edges.n, gl.UNSIGNED_SHORT, 0);
      }
    };
    const seeThrough = (b) => (b.kind === "gel" && !(mount !== null && b.mount === mount && mount !== head.world)) || (ghostly && b.kind === "rigid");
    gl.depthMask(true);
    for (const b of bodies) if (b.shown && !seeThrough(b)) paint(b, 1, b.kind === "gel" ? b.free : b.all);
    for (const b of bodies) if (b.shown && seeThrough(b)) {
      // Depth first, so that the nearest layer alone is blended.
      gl.colorMask(false, false, false, false); const mesh = b.soft; b.soft = false; gl.depthMask(true); paint(b, 1, b.all); gl.colorMask(true, true, true, true); b.soft = mesh;
      gl.depthFunc(gl.LEQUAL); paint(b, b.kind === "rigid" ? 0.3 : quantity === "" ? 0.62 : 0.9, b.all);
    }
    if (mount === null && wanted.points) {
      const variable = (name) => rgb(getComputedStyle(document.documentElement).getPropertyValue(name).trim());
      gl.useProgram(dots.p); gl.uniformMatrix4fv(dots.clip, false, clip); gl.uniform1f(dots.size, 5.5 * pixels);
      for (const group of [head.markers, head.cameras, head.sought]) for (const n in group) {
        const p = at(group[n].states, step), colour = variable(group === head.sought ? "--sought" : "--marker");
        gl.bindBuffer(gl.ARRAY_BUFFER, dotBuffer); gl.bufferData(gl.ARRAY_BUFFER, p, gl.DYNAMIC_DRAW);
        gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0); for (const s of [1, 2, 3]) gl.disableVertexAttribArray(s);
        for (const [test, alpha] of [[false, 0.3], [true, 1]]) { gl[test ? "enable" : "disable"](gl.DEPTH_TEST); gl.uniform4f(dots.colour, ...colour, alpha); gl.drawArrays(gl.POINTS, 0, p.length / 3); }
      }
      gl.enable(gl.DEPTH_TEST);
    }
  };

  // ---- the eyes of cameras
  const posed = (rows, k) => { const r = rows[Math.min(k, rows.length - 1)]; return { origin: local(r.slice(0, 3)), axes: [r.slice(3, 6), r.slice(6, 9), r.slice(9, 12)] }; };
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const drawEye = (target, clock) => {
    const name = target.dataset.camera, camera = head.cameras[name], ratio = Math.min(devicePixelRatio || 1, 2);
    const w = Math.round(target.clientWidth * ratio), h = Math.round(w * camera.height / camera.width), scale = w / camera.width;
    if (!w) return;
    if (target.width !== w || target.height !== h) { target.width = w; target.height = h; }
    canvas.width = w; canvas.height = h; gl.viewport(0, 0, w, h);
    const soft = rgb(style("--soft")); gl.clearColor(...soft, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { origin, axes } = posed(camera.poses, step);
    const eye = camera.parallel ? add(origin, axes[2], -5) : origin, reach = extent * 60;
    drawScene(clipOf(eye, axes, camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, camera.parallel ? 0.01 : extent * 0.02, camera.parallel ? 10 : reach, camera.parallel), eye, axes, camera.parallel, camera.mount, ratio);
    const g = target.getContext("2d"); g.drawImage(canvas, 0, 0);
    const first = camera.pixels[0], now = camera.pixels[step], seen = now.filter((p) => p[0] !== null).length;
    let largest = 0; now.forEach((p, i) => { if (p[0] !== null && first[i][0] !== null) largest = Math.max(largest, Math.hypot(p[0] - first[i][0], p[1] - first[i][1])); });
    const zoom = largest > 0.05 ? Math.max(1, Math.min(50, Math.pow(2, Math.floor(Math.log2(16 / largest))))) : 1;
    g.strokeStyle = g.fillStyle = "#15304f"; g.lineWidth = 1.4 * ratio;
    now.forEach((p, i) => {
      if (p[0] === null) return;
      const a = first[i][0] === null ? p : first[i], x = scale * a[0], y = scale * a[1], dx = scale * zoom * (p[0] - a[0]), dy = scale * zoom * (p[1] - a[1]);
      g.beginPath(); g.arc(x + (zoom > 1 ? 0 : dx), y + (zoom > 1 ? 0 : dy), 2.1 * ratio, 0, 7); g.fill();
      if (Math.hypot(dx, dy) > 2) { g.beginPath(); g.moveTo(x, y); g.lineTo(x + dx, y + dy); g.stroke(); }
    });
    if (camera.measured) {
      g.strokeStyle = "#d6336c"; g.lineWidth = 1.4 * ratio; const s = 3 * ratio;
      for (const p of camera.measured[step]) if (p[0] !== null) { const x = scale * p[0], y = scale * p[1]; g.beginPath(); g.moveTo(x - s, y - s); g.lineTo(x + s, y + s); g.moveTo(x + s, y - s); g.lineTo(x - s, y + s); g.stroke(); }
    }
    let words = `${seen} of ${now.length} points are in the picture.`;
    if (largest > 0.05) words += ` Lines show their motion since the start${zoom > 1 ? `, ${zoom} times as long` : ""}; the largest is ${largest.toPrecision(3)} px.`;
    if (camera.measured) {
      let sum = 0, n = 0; camera.measured[step].forEach((p, i) => { if (p[0] !== null && now[i] && now[i][0] !== null) { sum += (p[0] - now[i][0]) ** 2 + (p[1] - now[i][1]) ** 2; n++; } });
      words += n ? ` Crosses are as measured: residual ${Math.sqrt(sum / n).toPrecision(3)} px (RMS).` : " Nothing was measured at this time.";
    }
    target.nextElementSibling.textContent = words;
  };

  // ---- the main view
  const over = $("over"), pen = over.getContext("2d");
  const colours3 = ["#d62839", "#2b9348", "#3b82f6"];
  const drawMain = () => {
    const ratio = Math.min(devicePixelRatio || 1, 2), w = Math.round(over.clientWidth * ratio), h = Math.round(over.clientHeight * ratio);
    canvas.width = w; canvas.height = h; if (over.width !== w || over.height !== h) { over.width = w; over.height = h; }
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const axes = axesOf(view.ahead, view.up), distance = view.distance * Math.max(1, 1.25 * h / w), eye = add(view.target, view.ahead, -distance);
    const focal = 1.9 * h;
    drawScene(clipOf(eye, axes, focal, focal, w / 2, h / 2, w, h, distance * 0.02, distance + 60 * extent, false), eye, axes, false, null, ratio);
    pen.clearRect(0, 0, w, h); pen.lineCap = "round"; pen.lineJoin = "round";
    const place = (p) => { const d = sub(p, eye), z = dot(d, axes[2]); return z > distance * 0.02 ? [w / 2 + focal * dot(d, axes[0]) / z, h / 2 + focal * dot(d, axes[1]) / z] : null; };
    const line = (a, b, colour, width, dash = []) => { const p = place(a), q = place(b); if (!p || !q) return; pen.strokeStyle = colour; pen.lineWidth = width * ratio; pen.setLineDash(dash); pen.beginPath(); pen.moveTo(...p); pen.lineTo(...q); pen.stroke(); pen.setLineDash([]); };
    const taken = [];
    const label = (p, text, colour, bold = false) => {
      const q = p && place(p); if (!q || q[0] < 0 || q[1] < 0 || q[0] > w || q[1] > h) return;
      pen.font = `${bold ? 650 : 500} ${12.5 * ratio}px system-ui, sans-serif`; pen.lineWidth = 3.5 * ratio; pen.strokeStyle = style("--stage-top"); pen.fillStyle = colour;
      const long = pen.measureText(text).width, right = q[0] + long + 10 * ratio > w, x = q[0] + (right ? -long - 8 : 8) * 1; let y = q[1] + 4 * ratio;
      for (let k = 0; k < 12 && taken.some((t) => x < t[1] && x + long > t[0] && Math.abs(y - t[2]) < 14 * ratio); k++) y += 7 * ratio;
      taken.push([x, x + long, y]); pen.strokeText(text, x, y); pen.fillText(text, x, y);
    };
    const size = 0.13 * view.distance / 1.9;
    if (wanted.cones) for (const n in head.cameras) {
      const c = head.cameras[n], { origin, axes: a } = posed(c.poses, step), colour = style("--camera"), p = at(c.states, step);
      let depth = 0; for (let i = 0; i < p.length; i += 3) depth += dot(sub([p[i], p[i + 1], p[i + 2]], origin), a[2]) / (p.length / 3);
      for (const [reach, width] of [[0.6 * size, 1.6], [Math.max(depth, 1e-4), 0.7]]) {
        const corner = [[0, 0], [c.width, 0], [c.width, c.height], [0, c.height]].map(([u, v]) => { const s = c.parallel ? 1 : reach; return add(add(add(origin, a[0], s * (u - c.cx) / c.fx), a[1], s * (v - c.cy) / c.fy), a[2], c.parallel ? 0 : reach); });
        corner.forEach((q, k) => { if (!c.parallel) line(origin, q, colour, width); line(q, corner[(k + 1) % 4], colour, width); });
      }
      label(origin, n, colour);
    }
    if (wanted.axes) for (const n in head.mounts) { const { origin, axes: a } = posed(head.mounts[n], step); a.forEach((u, k) => line(origin, add(origin, u, size), colours3[k], 2.2)); label(origin, n, style("--muted")); }
    if (wanted.pairs) for (const pair of head.pairs) {
      const r = pair.points[Math.min(step, pair.points.length - 1)], a = local(r.slice(0, 3)), b = local(r.slice(3)), force = pair.force[step];
      line(a, b, style("--pair"), 2, [2 * ratio, 4 * ratio]); label(add(a, b).map((v) => v / 2), `${pair.pair}: ${force > 1e-6 ? force + " N" : pair.distance[step] + " mm apart"}`, style("--pair"));
    }
    if (wanted.names) for (const b of bodies) {
      if (!b.shown) continue;
      const p = at(b.states, step); let best = null, most = -Infinity;
      for (let i = 0; i < p.length; i += 3) { const q = place([p[i], p[i + 1], p[i + 2]]); if (q && q[0] > 9 && q[1] > 9 && q[0] < w - 9 && q[1] < h - 9 && q[0] + 0.6 * q[1] > most) { most = q[0] + 0.6 * q[1]; best = [p[i], p[i + 1], p[i + 2]]; } }
      label(best, b.name, style("--ink"), true);
    }
    const perPixel = distance / focal, most = 110 * ratio * perPixel, power = 10 ** Math.floor(Math.log10(most)), bar = [1, 2, 5].map((k) => k * power).filter((k) => k <= most).pop(), x = w - 14 * ratio, y = h - 14 * ratio;
    pen.strokeStyle = pen.fillStyle = style("--ink"); pen.lineWidth = 2.2 * ratio; pen.lineCap = "butt"; pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x - bar / perPixel, y); pen.stroke();
    pen.font = `500 ${12 * ratio}px system-ui, sans-serif`; pen.textAlign = "center"; pen.fillText(`${+(1e3 * bar).toPrecision(3)} mm`, x - bar / perPixel / 2, y - 7 * ratio); pen.textAlign = "left";
  };

  const drawChart = () => {
    const chart = $("chart"); if (!chart) return;
    const ratio = Math.min(devicePixelRatio || 1, 2), w = (chart.width = Math.round(chart.clientWidth * ratio)), h = (chart.height = Math.round(chart.clientHeight * ratio)), g = chart.getContext("2d"), wrench = head.wrenches[$("wrench").value];
    const all = [...wrench.force, ...(wrench.measured ?? [])].flat().filter((v) => v !== null), low = Math.min(0, ...all), high = Math.max(0, ...all), span = high - low || 1, left = 46 * ratio, bottom = 20 * ratio, t1 = head.times[count - 1] || 1;
    const X = (t) => left + (w - left - 8 * ratio) * t / t1, Y = (v) => 8 * ratio + (h - bottom - 12 * ratio) * (high - v) / span;
    g.font = `${11 * ratio}px system-ui, sans-serif`; g.fillStyle = style("--muted"); g.strokeStyle = style("--line"); g.lineWidth = ratio;
    for (const v of [low, 0, high]) { g.beginPath(); g.moveTo(left, Y(v)); g.lineTo(w, Y(v)); g.stroke(); if (v === 0 || Math.abs(Y(v) - Y(0)) > 12 * ratio) g.fillText(`${+v.toPrecision(2)}`, 2, Y(v) + 4 * ratio); }
    g.fillText("0 s", left, h - 4 * ratio); const end = `${+t1.toPrecision(3)} s`; g.fillText(end, w - g.measureText(end).width - 2, h - 4 * ratio);
    const curve = (rows, k, dash) => { g.setLineDash(dash); g.beginPath(); let open = false; rows.forEach((r, i) => { if (r[k] === null) { open = false; return; } g[open ? "lineTo" : "moveTo"](X(head.times[i]), Y(r[k])); open = true; }); g.stroke(); g.setLineDash([]); };
    colours3.forEach((c, k) => { g.strokeStyle = c; g.lineWidth = 1.8 * ratio; curve(wrench.force, k, []); if (wrench.measured) curve(wrench.measured, k, [2 * ratio, 3 * ratio]); });
    g.strokeStyle = style("--ink"); g.lineWidth = ratio; g.beginPath(); g.moveTo(X(head.times[step]), 4); g.lineTo(X(head.times[step]), h - bottom); g.stroke();
    $("chart-key").innerHTML = ["x", "y", "z"].map((n, k) => `<span class="key" style="--c: ${colours3[k]}">${n} ${(wrench.force[step][k] ?? 0).toFixed(3)}</span>`).join("") + (wrench.measured ? "dotted: as measured" : "");
  };

  const scale = `linear-gradient(90deg, ${Array.from({ length: 9 }, (_, k) => { const i = 3 * Math.round(k / 8 * (width - 1)); return `rgb(${table[i]},${table[i + 1]},${table[i + 2]})`; }).join(",")})`;
  const words = () => {
    if (count > 1) { $("clock").textContent = `${head.times[step].toFixed(2)} s`; $("time").value = step; }
    const q = head.quantities[quantity]; $("scale").hidden = !q;
    if (q) { $("scale-name").textContent = `${quantity} [${q.unit}]`; $("scale-name").title = q.words; $("scale-top").textContent = q.top; $("scale-bar").style.background = scale; }
    document.querySelectorAll("[data-swatch]").forEach((s) => { const b = head.bodies[s.dataset.swatch]; s.style.background = q && b.kind !== "rigid" && b.kind !== "plane" ? scale : b.colour; });
  };
  let last = 0;
  const frame = (now) => {
    if (playing) {
      if (now - last > 1000 * Math.max(head.times[count - 1], 2) / count / 1) { step = (step + 1) % count; last = now; dirty = true; }
    }
    if (dirty) { dirty = false; upload(); for (const eye of document.querySelectorAll(".eye")) drawEye(eye); drawMain(); drawChart(); words(); document.documentElement.dataset.drawn = step; }
    requestAnimationFrame(frame);
  };

  // ---- hands
  const fingers = new Map();
  const turn = (dx, dy) => { const r = axesOf(view.ahead, view.up)[0]; let a = turned(view.ahead, view.up, -0.008 * dx); const tilted = unit(turned(a, r, -0.008 * dy)); if (Math.abs(dot(tilted, view.up)) < 0.995) a = tilted; view.ahead = unit(a); dirty = true; };
  const move = (dx, dy) => { const [r, d] = axesOf(view.ahead, view.up), s = view.distance / (1.9 * over.clientHeight); view.target = add(add(view.target, r, -s * dx), d, -s * dy); dirty = true; };
  const zoom = (by) => { view.distance = Math.min(Math.max(view.distance * by, extent * 0.05), extent * 40); dirty = true; };
  over.addEventListener("contextmenu", (e) => e.preventDefault());
  over.addEventListener("pointerdown", (e) => { over.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); });
  for (const n of ["pointerup", "pointercancel"]) over.addEventListener(n, (e) => fingers.delete(e.pointerId));
  over.addEventListener("pointermove", (e) => {
    const before = fingers.get(e.pointerId); if (!before) return;
    const dx = e.clientX - before[0], dy = e.clientY - before[1];
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== e.pointerId)[1], was = Math.hypot(before[0] - other[0], before[1] - other[1]), is = Math.hypot(e.clientX - other[0], e.clientY - other[1]);
      if (is > 0) zoom(was / is); move(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons === 2 || e.buttons === 4) move(dx, dy); else turn(dx, dy);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  over.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(0.0012 * e.deltaY)); }, { passive: false });
  const go = (k) => { step = (k + count) % count; dirty = true; };
  over.addEventListener("keydown", (e) => {
    const keys = { ArrowLeft: () => turn(-20, 0), ArrowRight: () => turn(20, 0), ArrowUp: () => turn(0, -20), ArrowDown: () => turn(0, 20), "+": () => zoom(0.9), "-": () => zoom(1.1), ",": () => go(step - 1), ".": () => go(step + 1), " ": () => $("play")?.click() };
    if (keys[e.key]) { keys[e.key](); e.preventDefault(); }
  });
  const level = () => { const u = view.up, a = home.ahead; return unit(sub(a, u.map((v) => v * dot(a, u)))); };
  const nearestAxis = () => { const a = level(), k = [0, 1, 2].reduce((b, i) => (Math.abs(a[i]) > Math.abs(a[b]) ? i : b), 0), out = [0, 0, 0]; out[k] = Math.sign(a[k]); return out; };
  for (const b of document.querySelectorAll("[data-view]")) b.onclick = () => {
    const kind = b.dataset.view, f = nearestAxis(), tilt = (a, s) => unit(add(a, view.up, s));
    reset();
    if (kind !== "start") view.ahead = { front: tilt(f, -0.02), side: tilt(cross(view.up, f), -0.02), top: tilt(f.map((v) => 0.1 * v), -1), below: tilt(f.map((v) => 0.25 * v), 1) }[kind];
    dirty = true;
  };
  for (const b of document.querySelectorAll("[data-body]")) b.onchange = () => { bodies[b.dataset.body].shown = b.checked; dirty = true; };
  for (const id of ["mesh", "points", "axes", "cones", "pairs", "names"]) $(id).onchange = () => { dirty = true; };
  $("quantity").onchange = (e) => { quantity = e.target.value; dirty = true; };
  if ($("wrench")) $("wrench").onchange = () => { dirty = true; };
  if (count > 1) {
    $("time").oninput = (e) => { step = +e.target.value; dirty = true; };
    $("play").onclick = () => { playing = !playing; $("play").textContent = playing ? "Pause" : "Play"; };
    let most = 0; for (const q of Object.keys(head.quantities).slice(0, 1)) for (const b of bodies) { const v = b.values[q]; if (v) { const n = v.length / count; for (let k = 0; k < count; k++) { let s = 0; for (let i = 0; i < n; i++) if (v[k * n + i] < 255) s += v[k * n + i]; if (s > most) { most = s; step = k; } } } }
  }
  new ResizeObserver(() => { dirty = true; }).observe($("stage"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
  requestAnimationFrame(frame);
})();
