// SPDX-License-Identifier: Apache-2.0
// Lines over the last seconds on a 2D canvas, and bars per cable as SVG.
"use strict";

const SERIES = ["#3b82c4", "#e08214", "#2a9d64", "#c6509b", "#8a6fd1", "#a6761d", "#17a2b8", "#d1495b",
                "#6a994e", "#7b8794", "#b5838d", "#4d908e", "#f3a712", "#577590", "#9c6644", "#5e60ce"];

// Values over time, of the last `span` seconds.
class Track {
  constructor(span) { this.span = span; this.clear(); }
  clear() { this.items = []; }
  push(item) {
    this.items.push(item);
    while (this.items.length && item.t - this.items[0].t > this.span) this.items.shift();
  }
}

// Step between ticks: 1, 2 or 5 times a power of ten, at most n of them over a range.
function tickStep(range, n) {
  const base = 10 ** Math.floor(Math.log10(range / n));
  return [1, 2, 5, 10].map((k) => k * base).find((k) => range / k <= n);
}

// "12.3" with as many decimals as the step needs; at most six figures.
function tickText(v, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return (digits > 6 || Math.abs(v) >= 1e6 ? v.toExponential(1) : v.toFixed(digits)).replace("-", "−");
}

// Range of the greater part of a value with its band about its newest: what came before it settled does not flatten it.
function settledRange(points) {
  if (!points.length) return null;
  const [, a, b] = points[points.length - 1];
  const final = (a + b) / 2;
  const away = points.map(([, low, high]) => Math.max(final - low, high - final)).sort((x, y) => x - y);
  const reach = 1.25 * Math.max(away[Math.floor(0.75 * (away.length - 1))], b - a, 1e-6);
  return [final - reach, final + reach];
}

function bounds(chart) {
  if (chart.range) return chart.range;
  let [low, high] = [Infinity, -Infinity];
  const see = (v) => { if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); } };
  for (const line of chart.lines) for (const [, a, b] of line.points) { see(a); see(b); }
  if (!Number.isFinite(low)) return null;
  for (const v of chart.include ?? []) see(v);
  const least = chart.least ?? 1e-9;
  const room = Math.max((high - low) * 0.08, (least - (high - low)) / 2, 1e-12);
  return [chart.include?.includes(low) ? low : low - room, high + room];
}

// chart: end, span in s; lines [{points: [[t, low, high]], color, band: filled between}]; rules [{y, color}]; include [y];
// marks [t]: events.
function drawChart(canvas, chart, style) {
  const ratio = window.devicePixelRatio || 1;
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  if (!w || !h) return;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio);
  }
  const g = canvas.getContext("2d", { willReadFrequently: true });
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, w, h);
  g.font = "11px system-ui, sans-serif";
  const range = bounds(chart);
  if (!range) {
    g.fillStyle = style("--soft"); g.textAlign = "center";
    g.fillText("no data yet", w / 2, h / 2);
    return;
  }
  const [low, high] = range;
  const step = tickStep(high - low, h > 140 ? 5 : 4);
  const ticks = [];
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) ticks.push(Math.abs(v) < step / 1e6 ? 0 : v);
  const left = 6 + Math.max(...ticks.map((v) => g.measureText(tickText(v, step)).width), 10);
  const [top, bottom, right] = [6, h - 18, w - 4];
  const x = (t) => right - (chart.end - t) / chart.span * (right - left);
  const y = (v) => bottom - (v - low) / (high - low) * (bottom - top);
  drawAxes(g, chart, { left, right, top, bottom, x, y, ticks, step }, style);
  g.save();
  g.beginPath(); g.rect(left, top, right - left, bottom - top); g.clip();
  for (const rule of chart.rules ?? []) {
    g.beginPath(); g.moveTo(left, y(rule.y)); g.lineTo(right, y(rule.y));
    g.strokeStyle = rule.color; g.lineWidth = 1.5; g.setLineDash([5, 4]); g.stroke(); g.setLineDash([]);
  }
  for (const t of chart.marks ?? []) {
    g.beginPath(); g.moveTo(x(t), top); g.lineTo(x(t), bottom);
    g.strokeStyle = style("--soft"); g.lineWidth = 1; g.setLineDash([2, 3]); g.stroke(); g.setLineDash([]);
  }
  for (const line of chart.lines) drawLine(g, line, x, y);
  g.restore();
}

function drawAxes(g, chart, a, style) {
  g.strokeStyle = style("--line"); g.lineWidth = 1; g.fillStyle = style("--soft");
  g.textAlign = "right"; g.textBaseline = "middle";
  for (const v of a.ticks) {
    g.beginPath(); g.moveTo(a.left, a.y(v)); g.lineTo(a.right, a.y(v)); g.stroke();
    if (a.y(v) > a.top + 3) g.fillText(tickText(v, a.step), a.left - 4, a.y(v));
  }
  g.textBaseline = "top";
  const n = a.right - a.left > 300 ? 3 : 2;
  for (let k = 0; k <= n; k += 1) {
    const back = chart.span * (n - k) / n;
    g.textAlign = k === n ? "right" : k ? "center" : "left";
    g.fillText(back ? `−${back} s` : "now", a.x(chart.end - back), a.bottom + 5);
  }
}

function drawLine(g, line, x, y) {
  const points = line.points;
  g.lineJoin = "round";
  if (line.band) {
    g.beginPath();
    points.forEach(([t, , b], i) => (i ? g.lineTo(x(t), y(b)) : g.moveTo(x(t), y(b))));
    for (let i = points.length - 1; i >= 0; i -= 1) g.lineTo(x(points[i][0]), y(points[i][1]));
    g.closePath(); g.globalAlpha = line.band; g.fillStyle = line.color; g.fill(); g.globalAlpha = 1;
  }
  if (!line.width) return;
  g.beginPath();
  let before = null;
  for (const [t, a, b] of points) {
    const v = (a + b) / 2;
    if (before !== null && t - before < line.gap) g.lineTo(x(t), y(v)); else g.moveTo(x(t), y(v));
    before = t;
  }
  g.strokeStyle = line.color; g.lineWidth = line.width; g.stroke();
}

const SVG = "http://www.w3.org/2000/svg";
function shape(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

// A row per cable: number, bar on a track, value. set(i, {from, to, mark, color, text}), positions in 0 .. 1.
class CableBars {
  constructor(parent, n) {
    parent.replaceChildren();
    this.rows = Array.from({ length: n }, (_, i) => {
      const row = document.createElement("div"), number = document.createElement("b"), value = document.createElement("span");
      row.className = "row"; number.textContent = String(i + 1); value.textContent = "–";
      const svg = shape("svg", { viewBox: "0 0 1000 10", preserveAspectRatio: "none", "aria-hidden": "true" });
      shape("rect", { class: "track", x: 0, y: 3.5, width: 1000, height: 3 }, svg);
      const bar = shape("rect", { x: 0, y: 2, width: 0, height: 6 }, svg);
      const mark = shape("rect", { x: -20, y: 0, width: 6, height: 10 }, svg);
      row.append(number, svg, value); parent.append(row);
      return { bar, mark, value };
    });
  }

  set(i, { from, to, mark, color, text }) {
    const { bar, mark: dash, value } = this.rows[i];
    const within = (v) => 1000 * Math.min(1, Math.max(0, v));
    bar.setAttribute("x", within(from)); bar.setAttribute("width", Math.max(2, within(to) - within(from)));
    bar.setAttribute("fill", color); bar.setAttribute("opacity", mark === undefined ? 1 : 0.45);
    dash.setAttribute("x", mark === undefined ? -20 : within(mark) - 3); dash.setAttribute("fill", color);
    if (value.textContent !== text) value.textContent = text;
  }
}
