// SPDX-License-Identifier: Apache-2.0
// The robot in 3D on a 2D canvas: perspective, cables coloured by tension, platform, CoG, ellipsoid of inertia.
"use strict";

const V = {
  add: (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]],
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  scale: (a, k) => [a[0] * k, a[1] * k, a[2] * k],
  unit: (a) => V.scale(a, 1 / (Math.hypot(...a) || 1)),
  turn: (R, a) => [0, 1, 2].map((i) => R[3 * i] * a[0] + R[3 * i + 1] * a[1] + R[3 * i + 2] * a[2]),
};

// Share of the way from tension_min to tension_max: logarithmic, as tensions spread over decades; outside: < 0 or > 1.
function tensionShare(f, [low, high]) {
  if (f < low) return -1;
  if (f > high) return 2;
  return low > 0 && high / low > 3 ? Math.log(f / low) / Math.log(high / low) : (f - low) / (high - low || 1);
}

// Colours from tension_min, 0, to tension_max, 1: [share, [red, green, blue]]; the server's.
let RAMP = [[0, [128, 128, 128]], [1, [128, 128, 128]]];
function rampColor(share) {
  const at = Math.max(1, RAMP.findIndex(([s]) => s >= share));
  const [[s0, a], [s1, b]] = [RAMP[at - 1], RAMP[at]];
  const k = Math.min(1, Math.max(0, (share - s0) / (s1 - s0)));
  return `rgb(${a.map((v, i) => Math.round(v + k * (b[i] - v))).join(",")})`;
}

class View3D {
  constructor(canvas, style) {
    Object.assign(this, { canvas, style, azimuth: -1.05, elevation: 0.38, zoom: 1, isNear: false, robot: null, pose: null,
                          body: null, trail: [], nDrawn: 0 });
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (e) => { this.pointers.set(e.pointerId, e); canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointermove", (e) => this.drag(e));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoomBy(Math.exp(-0.0015 * e.deltaY)); }, { passive: false });
    canvas.addEventListener("keydown", (e) => this.key(e));
  }

  drag(e) {
    const was = this.pointers.get(e.pointerId);
    if (!was) return;
    if (this.pointers.size === 2) {
      const other = [...this.pointers.values()].find((p) => p.pointerId !== e.pointerId);
      const far = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY) || 1;
      this.zoomBy(far(e) / far(was));
    } else {
      this.turnBy(-0.008 * (e.clientX - was.clientX), 0.008 * (e.clientY - was.clientY));
    }
    this.pointers.set(e.pointerId, e);
  }

  key(e) {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
    if (step) this.turnBy(...step);
    else if (e.key === "+") this.zoomBy(1.15);
    else if (e.key === "-") this.zoomBy(1 / 1.15);
    else return;
    e.preventDefault();
  }

  turnBy(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(1.5, Math.max(-0.3, this.elevation + elevation));
    this.draw();
  }

  zoomBy(factor) {
    this.zoom = Math.min(8, Math.max(0.3, this.zoom * factor));
    this.draw();
  }

  setView(isNear) {
    this.isNear = isNear;
    this.zoom = 1;
    this.draw();
  }

  setRobot(robot) {
    this.robot = robot;
    this.trail = [];
    const reach = robot.attachments.map((b) => Math.hypot(...b));
    this.size = Math.max(...reach, 0.01);
    const all = robot.anchors;
    this.floor = Math.min(0, ...all.map((a) => a[2]));
    this.low = [0, 1].map((i) => Math.min(...all.map((a) => a[i])));
    this.high = [0, 1].map((i) => Math.max(...all.map((a) => a[i])));
    this.top = Math.max(...all.map((a) => a[2]));
  }

  setPose(pose) {
    this.pose = pose.p ? pose : this.pose && { ...this.pose, f: pose.f };
    if (!pose.p) return;
    const last = this.trail[this.trail.length - 1];
    if (!last || pose.t - last.t > 0.15) this.trail.push({ t: pose.t, p: pose.p });
    while (this.trail.length && pose.t - this.trail[0].t > 60) this.trail.shift();
  }

  // Camera that shows the points of interest: direction from angles, distance so that they fill the canvas.
  aim(w, h) {
    const [c, s] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const back = [c * Math.cos(this.azimuth), c * Math.sin(this.azimuth), s];
    const right = V.unit(V.cross(V.scale(back, -1), [0, 0, 1]));
    const up = V.cross(back, right);
    const P = this.pose ? this.pose.p : [0, 1].map((i) => (this.low[i] + this.high[i]) / 2).concat(this.top / 2);
    const r = 1.5 * this.size;
    const points = this.isNear
      ? [-r, r].flatMap((x) => [-r, r].flatMap((y) => [-r, r].map((z) => V.add(P, [x, y, z]))))
      : [0, 1].flatMap((i) => [0, 1].flatMap((j) => [this.floor, this.top].map((z) => [[this.low, this.high][i][0], [this.low, this.high][j][1], z])));
    const target = V.scale(points.reduce(V.add, [0, 0, 0]), 1 / points.length);
    const radius = Math.max(...points.map((q) => Math.hypot(...V.sub(q, target))));
    const eye = V.add(target, V.scale(back, 3.2 * radius));
    const flat = (q) => {
      const d = V.sub(q, eye);
      const depth = Math.max(-V.dot(d, back), 1e-3);
      return [V.dot(d, right) / depth, -V.dot(d, up) / depth, depth];
    };
    const seen = points.map(flat);
    const [[left, top], [end, bottom]] = [Math.min, Math.max].map((f) => [0, 1].map((i) => f(...seen.map((q) => q[i]))));
    const focal = this.zoom * Math.min((w - 50) / (end - left), (h - 60) / (bottom - top));
    this.project = (q) => {
      const [x, y, depth] = flat(q);
      return [w / 2 + focal * (x - (left + end) / 2), h / 2 + 8 + focal * (y - (top + bottom) / 2), depth];
    };
    this.frame = { right, up, back, focal };
  }

  stroke(points, color, width, dash = []) {
    const g = this.g;
    g.beginPath();
    points.forEach((q, i) => { const [x, y] = this.project(q); if (i) g.lineTo(x, y); else g.moveTo(x, y); });
    g.strokeStyle = color; g.lineWidth = width; g.setLineDash(dash); g.stroke(); g.setLineDash([]);
  }

  label(text, q, color, dx = 0, dy = 0) {
    const [x, y] = this.project(q);
    const g = this.g;
    g.font = "600 12px system-ui, sans-serif"; g.textAlign = "center"; g.textBaseline = "middle";
    g.lineWidth = 3; g.strokeStyle = this.style("--card"); g.strokeText(text, x + dx, y + dy);
    g.fillStyle = color; g.fillText(text, x + dx, y + dy);
  }

  dot(q, color, r, isHollow = false) {
    const [x, y] = this.project(q);
    this.g.beginPath(); this.g.arc(x, y, r, 0, 7);
    this.g.fillStyle = isHollow ? this.style("--card") : color; this.g.fill();
    this.g.strokeStyle = color; this.g.lineWidth = 1.5; this.g.stroke();
  }

  drawFloor() {
    const span = Math.max(this.high[0] - this.low[0], this.high[1] - this.low[1], 1e-3);
    const step = [1, 2, 5, 10].map((k) => k * 10 ** Math.floor(Math.log10(span / 8))).find((k) => span / k <= 12);
    const at = (i) => {
      const found = [];
      for (let v = Math.ceil(this.low[i] / step) * step; v <= this.high[i] + 1e-9; v += step) found.push(v);
      return found;
    };
    const line = this.style("--line");
    for (const x of at(0)) this.stroke([[x, this.low[1], this.floor], [x, this.high[1], this.floor]], line, 1);
    for (const y of at(1)) this.stroke([[this.low[0], y, this.floor], [this.high[0], y, this.floor]], line, 1);
    for (const a of this.robot.anchors) this.stroke([a, [a[0], a[1], this.floor]], this.style("--line"), 2);
  }

  drawCables() {
    const { p, R, leave, f } = this.pose;
    const corner = this.robot.attachments.map((b) => V.add(p, V.turn(R, b)));
    corner.forEach((b, i) => {
      const share = f[i] === undefined ? -1 : tensionShare(f[i], this.robot.limits[i]);
      const color = share < 0 ? this.style("--slack") : share > 1 ? this.style("--bad") : rampColor(share);
      this.stroke([b, leave[i]], color, share < 0 || share > 1 ? 3.5 : 2.2, share < 0 ? [6, 5] : []);
    });
    this.drawNumbers(corner, leave);
    return corner;
  }

  // Numbers at the pulleys; where two would touch, the second moves along the canvas.
  drawNumbers(corner, leave) {
    const taken = [];
    leave.forEach((a, i) => {
      this.dot(a, this.style("--soft"), 3);
      const [x, y] = this.project(a);
      let [dx, dy] = [0, -13];
      while (taken.some(([u, v]) => Math.abs(u - x - dx) < 16 && Math.abs(v - y - dy) < 14)) { dx += 17; if (dx > 60) { dx = 0; dy += 28; } }
      taken.push([x + dx, y + dy]);
      this.label(String(i + 1), a, this.style("--ink"), dx, dy);
    });
    if (!this.isNear) return;
    const marks = this.body ? [this.project(V.add(this.pose.p, V.turn(this.pose.R, this.body.value.slice(1, 4))))] : [];
    corner.forEach((b, i) => {
      this.dot(b, this.style("--soft"), 2.5);
      const [n, m] = [this.project(b), this.project(leave[i])];
      const far = Math.hypot(m[0] - n[0], m[1] - n[1]) || 1;
      const at = (k) => [n[0] + k * (m[0] - n[0]) / far, n[1] + k * (m[1] - n[1]) / far];
      let along = 26;  // px along the cable, further where another mark is
      while (along < 120 && marks.some(([u, v]) => Math.hypot(at(along)[0] - u, at(along)[1] - v) < 24)) along += 12;
      marks.push(at(along));
      this.label(String(i + 1), b, this.style("--soft"), at(along)[0] - n[0], at(along)[1] - n[1]);
    });
  }

  drawPlatform(corner) {
    const g = this.g;
    const faces = this.robot.triangles.map((k) => {
      const [a, b, c] = k.map((i) => corner[i]);
      const n = V.unit(V.cross(V.sub(b, a), V.sub(c, a)));
      return { flat: k.map((i) => this.project(corner[i])), light: Math.abs(V.dot(n, [0.3, 0.5, 0.81])) };
    });
    faces.sort((a, b) => b.flat.reduce((s, q) => s + q[2], 0) - a.flat.reduce((s, q) => s + q[2], 0));
    for (const { flat, light } of faces) {
      g.beginPath(); flat.forEach(([x, y], i) => (i ? g.lineTo(x, y) : g.moveTo(x, y))); g.closePath();
      g.fillStyle = this.style("--soft"); g.globalAlpha = 0.08 + 0.12 * light; g.fill(); g.globalAlpha = 1;
    }
    for (const [a, b] of this.robot.edges) this.stroke([corner[a], corner[b]], this.style("--soft"), 1.5);
    if (!this.robot.edges.length) this.stroke([...corner, corner[0]], this.style("--soft"), 1.5);
  }

  // Outline of an ellipsoid: of the 3 x 3 shape matrix as seen at its centre, an ellipse of the image plane.
  outline(center, columns, color, alpha, dash) {
    const { right, up, focal } = this.frame;
    const [x, y, depth] = this.project(center);
    const k = focal / depth;
    const [u, v] = [columns.map((c) => k * V.dot(c, right)), columns.map((c) => -k * V.dot(c, up))];
    const [a, b, c] = [V.dot(u, u), V.dot(u, v), V.dot(v, v)];
    const [mean, half] = [(a + c) / 2, Math.hypot((a - c) / 2, b)];
    const g = this.g;
    g.beginPath();
    g.ellipse(x, y, Math.sqrt(mean + half), Math.sqrt(Math.max(mean - half, 0)), 0.5 * Math.atan2(2 * b, a - c), 0, 7);
    if (alpha) { g.globalAlpha = alpha; g.fillStyle = color; g.fill(); g.globalAlpha = 1; }
    g.strokeStyle = color; g.lineWidth = dash.length ? 1 : 1.5; g.setLineDash(dash); g.stroke(); g.setLineDash([]);
  }

  drawBody(value, solid, color, isMain) {
    const { p, R } = this.pose;
    const center = V.add(p, V.turn(R, value.slice(1, 4)));
    if (solid) {
      const axis = [0, 1, 2].map((j) => V.turn(R, [0, 1, 2].map((i) => solid.axes[3 * i + j])));
      const shape = (k) => axis.map((a, j) => V.scale(a, Math.max(solid.size[j] + k * solid.sigma[j], 0)));
      this.outline(center, shape(0), color, isMain ? 0.16 : 0, isMain ? [] : [2, 3]);
      if (isMain) {
        for (const k of [-1, 1]) this.outline(center, shape(k), color, 0, [4, 4]);
        for (const [a, b] of [[0, 1], [1, 2], [0, 2]]) {
          const [m, n] = [shape(0)[a], shape(0)[b]];
          const round = Array.from({ length: 49 }, (_, i) => V.add(center, V.add(V.scale(m, Math.cos(i * Math.PI / 24)), V.scale(n, Math.sin(i * Math.PI / 24)))));
          this.g.globalAlpha = 0.55; this.stroke(round, color, 1); this.g.globalAlpha = 1;
        }
      }
    }
    this.dot(center, color, isMain ? 4.5 : 4, !isMain);
    if (isMain) this.label("C", center, color, 12, 10);
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!w || !h) return;
    if (this.canvas.width !== Math.round(w * ratio) || this.canvas.height !== Math.round(h * ratio)) {
      this.canvas.width = Math.round(w * ratio); this.canvas.height = Math.round(h * ratio);
    }
    const g = this.g = this.canvas.getContext("2d", { willReadFrequently: true });
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, w, h);
    g.lineJoin = g.lineCap = "round";
    if (!this.robot) return this.say("waiting for the robot's geometry (CONFIG, once a second)", w, h);
    this.aim(w, h);
    this.drawFloor();
    if (!this.pose) return this.say("waiting for forces, attitude and position", w, h);
    if (this.trail.length > 1) this.stroke(this.trail.map((x) => x.p), this.style("--faint"), 1.5);
    const corner = this.drawCables();
    this.drawPlatform(corner);
    if (this.robot.solid) this.drawBody(this.robot.nominal, this.robot.solid, this.style("--truth"), false);
    if (this.body) this.drawBody(this.body.value, this.body.solid, this.style("--estimate"), true);
    this.nDrawn += 1;
  }

  say(text, w, h) {
    this.g.fillStyle = this.style("--soft"); this.g.font = "13px system-ui, sans-serif"; this.g.textAlign = "center";
    this.g.fillText(text, w / 2, h / 2);
  }
}
