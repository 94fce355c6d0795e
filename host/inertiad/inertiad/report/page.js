// SPDX-License-Identifier: Apache-2.0
// Draws every drawing of the page in the browser's theme and width, and again when one of them changes.
(() => {
  "use strict";
  const palettes = JSON.parse(document.getElementById("palettes").textContent);
  const drawings = JSON.parse(document.getElementById("drawings").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const config = (isFlat) => ({ displaylogo: false, displayModeBar: isFlat ? false : "hover" });
  const panel = { width: 215, gapX: 62, gapY: 66, top: 30, bare: 10, bottom: 40, legend: 30, legendWidth: 600, narrowAway: 1.5, left: 56, right: 12 };
  let isPrinting = false;

  // "@role" and "@role/opacity" -> a colour of the theme; "#rrggbb/opacity" as well
  function tint(text, palette) {
    const [name, opacity] = text.split("/");
    const hex = name.startsWith("@") ? palette[name.slice(1)] : name;
    if (opacity === undefined) return hex;
    const [r, g, b] = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
    return `rgba(${r},${g},${b},${opacity})`;
  }

  function painted(value, palette) {
    if (typeof value === "string") return /^(@|#[0-9a-f]{6}\/)/.test(value) ? tint(value, palette) : value;
    if (Array.isArray(value)) return value.map((v) => painted(v, palette));
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, painted(v, palette)]));
  }

  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function axisLooks(axis) {
    const line = style("--line");
    return { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true, ...axis,
             title: { font: { size: 11 }, standoff: 4, ...axis.title }, tickfont: { size: 10 } };
  }

  // Panels in a grid of as many columns as there is room for; gaps in pixels.
  function placed(layout, grid, width) {
    const n = grid.titles.length;
    const columns = Math.max(1, Math.min(grid.columns, n, Math.floor(width / panel.width)));
    const rows = Math.ceil(n / columns);
    const height = rows * grid.height + (rows - 1) * panel.gapY;
    const inner = width - panel.left - panel.right;
    const one = (inner - (columns - 1) * panel.gapX) / columns;
    const titles = [];
    grid.titles.forEach((title, i) => {
      const [row, column, id] = [Math.floor(i / columns), i % columns, i === 0 ? "" : String(i + 1)];
      const x = (column * (one + panel.gapX)) / inner;
      const y = 1 - (row * (grid.height + panel.gapY)) / height;
      layout[`xaxis${id}`] = axisLooks({ ...layout[`xaxis${id}`], domain: [x, Math.min(1, x + one / inner)], anchor: `y${id}` });
      layout[`yaxis${id}`] = axisLooks({ ...layout[`yaxis${id}`], domain: [Math.max(0, y - grid.height / height), y], anchor: `x${id}` });
      if (title) titles.push({ text: title, xref: "paper", yref: "paper", x, y, xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12 } });
    });
    const top = titles.length ? panel.top : panel.bare;
    const bottom = panel.bottom + (layout.showlegend ? panel.legend : 0);
    return { ...layout, annotations: titles, height: height + top + bottom,
             margin: { t: top, b: bottom, l: panel.left, r: panel.right } };
  }

  function spatial(layout, width) {
    const looks = (axis) => ({ ...axisLooks(axis), backgroundcolor: "rgba(0,0,0,0)", showspikes: false });
    const { xaxis, yaxis, zaxis, camera } = layout.scene;
    const away = width > panel.legendWidth ? 1 : panel.narrowAway;
    const eye = Object.fromEntries(Object.entries(camera.eye).map(([axis, v]) => [axis, away * v]));
    const scene = { ...layout.scene, camera: { ...camera, eye }, xaxis: looks(xaxis), yaxis: looks(yaxis), zaxis: looks(zaxis) };
    return { ...layout, scene, showlegend: width > panel.legendWidth, height: Math.min(600, Math.max(380, 0.6 * width)), margin: { t: 40, b: 0, l: 0, r: 0 },
             legend: { x: 1, xanchor: "right", y: 1, bgcolor: "rgba(0,0,0,0)", font: { size: 11 } } };
  }

  function hasWebGl() {
    const canvas = document.createElement("canvas");
    return Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
  }

  function draw(box) {
    const drawing = drawings[box.dataset.key];
    const palette = { ...palettes[!isPrinting && dark.matches ? "dark" : "light"], ground: isPrinting ? "#ffffff" : style("--card") };
    const { data, layout } = painted({ data: drawing.data, layout: drawing.layout }, palette);
    const width = box.clientWidth;
    const base = { width, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { family: "inherit", color: palette.ink, size: 11 },
                   legend: { orientation: "h", x: 0, y: 0, yref: "container", yanchor: "bottom" }, hovermode: "closest", uirevision: "kept",
                   modebar: { bgcolor: "rgba(0,0,0,0)", color: palette.muted, activecolor: palette.ink } };
    const whole = drawing.grid ? placed({ ...base, ...layout }, drawing.grid, width) : spatial({ ...base, ...layout }, width);
    return Plotly.react(box, data, whole, config(Boolean(drawing.grid)));
  }

  const canTurn = hasWebGl();
  const boxes = [...document.querySelectorAll(".drawing")].filter((box) => {
    if (!box.classList.contains("scene") || canTurn) return true;
    box.remove();
    return false;
  });
  if (!canTurn) document.querySelectorAll(".still").forEach((image) => image.classList.add("shown"));

  const drawAll = () => Promise.all(boxes.filter((box) => box.clientWidth > 0).map(draw));
  let width = window.innerWidth;
  let waiting = 0;
  window.addEventListener("resize", () => {
    if (window.innerWidth === width || isPrinting) return;
    width = window.innerWidth;
    clearTimeout(waiting);
    waiting = setTimeout(drawAll, 150);
  });
  dark.addEventListener("change", drawAll);
  window.addEventListener("beforeprint", () => { isPrinting = true; drawAll(); });
  window.addEventListener("afterprint", () => { isPrinting = false; drawAll(); });
  drawAll().then(() => { document.documentElement.dataset.drawn = String(boxes.length); });
})();
