// SPDX-License-Identifier: Apache-2.0
// Takes the server's items and draws them: the robot with each pose, charts and numbers a few times a second.
(() => {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const token = document.querySelector('meta[name="token"]').content;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let styles = {};
  const style = (name) => (styles[name] ??= getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  dark.addEventListener("change", () => { styles = {}; drawAll(); });

  const DEGREES = 180 / Math.PI;
  const AXES = [["x", SERIES[0]], ["y", SERIES[1]], ["z", SERIES[2]]];
  const CHART_PERIOD = 200;  // ms
  const SILENCE = 6000;  // ms without a byte after which the stream is opened again
  const view = new View3D($("view"), style);
  const shown = { span: 60, names: [], units: [], robot: null, estimate: null, pose: null, marks: [], isCommanding: token !== "" };
  const tracks = { row: new Track(60), estimate: new Track(60), residual: new Track(60) };
  let gauges = null, bars = null, isPoseNew = false, heard = performance.now(), stream = null, state = null, end = 0;

  function text(node, value) { if (node.textContent !== value) node.textContent = value; }

  function made(tag, value, className = "") {
    const node = document.createElement(tag);
    node.textContent = value; node.className = className;
    return node;
  }

  function row(cells, kinds = []) {
    const tr = document.createElement("tr");
    cells.forEach((cell, i) => {
      const node = made(i ? "td" : "th", cell, kinds[i] ?? "");
      if (!i) node.scope = "row";
      tr.append(node);
    });
    return tr;
  }

  // CoG in mm; everything else in its SI unit.
  const factor = (i) => (shown.units[i] === "m" ? 1000 : 1);
  const unit = (i) => ({ m: "mm", "kg m2": "kg m²" })[shown.units[i]] ?? shown.units[i];
  const digits = (sigma) => Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(sigma || 1))));
  const plain = (v, n) => `${v < 0 && Number(v.toFixed(n)) !== 0 ? "−" : ""}${Math.abs(v).toFixed(n)}`;
  const signed = (v, n) => plain(v, n).replace(/^(?=\d)/, "+");

  // ---- items ---------------------------------------------------------------------------------------------------------

  const take = {
    start(item) {
      Object.assign(shown, { span: item.span, names: item.names, units: item.units, estimate: null, pose: null, marks: [] });
      RAMP = item.ramp;
      drawRamp();
      for (const track of Object.values(tracks)) track.clear();
      Object.assign(view, { pose: null, body: null, trail: [] });
      end = 0;
      $("events").replaceChildren();
      $("parameters").replaceChildren(...item.names.map((name, i) => {
        const cell = document.createElement("div"), head = document.createElement("p"), canvas = document.createElement("canvas");
        head.append(made("b", `${name}, ${unit(i)}`), made("span", "–"));
        canvas.className = "chart"; canvas.setAttribute("role", "img"); canvas.setAttribute("aria-label", `${name} over the last minute`);
        cell.append(head, canvas);
        return cell;
      }));
      $("ten").replaceChildren(...item.names.map((name, i) => row([name, "–", "–", "–", "–", unit(i)])));
    },
    robot(item) {
      shown.robot = item;
      view.setRobot(item);
      text($("name"), item.name || "robot"); document.title = `${item.name || "robot"}: live`;
      text($("expected"), item.expected); text($("reference"), item.expected);
      gauges = new CableBars($("gauges"), item.anchors.length);
      bars = new CableBars($("bars"), item.anchors.length);
      for (const box of ["gauges", "bars"]) {
        const ends = made("div", "", "ends");
        ends.append(made("span", ""), made("span", ""));
        $(box).append(ends);
      }
      $("cables").replaceChildren(...item.anchors.map((_, i) => {
        const key = made("span", `cable ${i + 1}`), line = made("i", "", "line");
        line.style.color = SERIES[i % SERIES.length];
        key.prepend(line);
        return key;
      }));
      drawTen();
      isPoseNew = true;
    },
    pose(item) { shown.pose = item; view.setPose(item); isPoseNew = true; end = Math.max(end, item.t); },
    row(item) { tracks.row.push(item); end = Math.max(end, item.t); },
    estimate(item) {
      tracks.estimate.push(item);
      shown.estimate = view.body = item;
      drawTen();
    },
    residual(item) { tracks.residual.push(item); },
    health(item) { drawHealth(item); },
    event(item) {
      if (item.what === "news") shown.marks.push(item.t);
      shown.marks = shown.marks.filter((t) => end - t < shown.span);
      const line = made("li", "", item.what), clock = made("time", item.clock || "–");
      line.append(clock, made("b", item.source), ` ${item.text}`);
      $("events").prepend(line);
      while ($("events").childElementCount > 50) $("events").lastElementChild.remove();
    },
    state(item) { state = item; drawState(); },
  };

  function drawTen() {
    const found = shown.estimate, robot = shown.robot;
    [...$("ten").rows].forEach((tr, i) => {
      const k = factor(i), sigma = found ? k * found.std[i] : 0, n = found ? digits(sigma) : 1;
      const cells = ["", "–", "–", "–", "–"];
      if (found) [cells[1], cells[2]] = [plain(k * found.value[i], n), sigma.toFixed(n)];
      if (robot) cells[3] = plain(k * robot.nominal[i], Math.min(n, 3));
      if (found && robot) cells[4] = signed(k * (found.value[i] - robot.nominal[i]), n);
      cells.forEach((cell, j) => { if (j) text(tr.cells[j], cell); });
      tr.className = found && !found.observable[i] ? "faint" : "";
      tr.title = found && !found.observable[i] ? "not observable yet: sigma is above half the prior's" : "";
      if (found) text($("parameters").children[i].querySelector("span"), `${cells[1]} ± ${cells[2]}`);
    });
    if (!found) return text($("quality"), "");
    const [windows, rows, dropped, changes] = found.counts;
    text($("quality"), `NIS ${found.nis.toFixed(1)} (6 expected) · ${windows} windows · ${rows} rows · ${dropped} dropped · ` +
                       `${changes} payload change${changes === 1 ? "" : "s"}`);
  }

  function drawHealth(item) {
    $("buses").replaceChildren(...item.buses.map((b) => row(
      [b.name, b.state, b.load === null ? "–" : (100 * b.load).toFixed(1), b.rate === null ? "–" : b.rate.toFixed(0), String(b.errors), String(b.lost)],
      ["", b.state === "active" ? "good" : "bad", "", "", b.errors ? "bad" : "", b.lost ? "bad" : ""])));
    $("latencies").replaceChildren(...item.latencies.map((x) => row([x.name, ...x.s.map((s) => (1e3 * s).toFixed(2))])));
    if (!item.latencies.length) {
      $("latencies").append(row(["none measured: frames come from a file"]));
      $("latencies").rows[0].cells[0].colSpan = 5;
    }
    $("ages").replaceChildren(...["IMU", "force", "position"].map((name, i) => made(
      "span", item.age[i] < 0 ? `${name} none yet` : `${name} ${(1e3 * item.age[i]).toFixed(0)} ms`,
      item.age[i] > 0.5 || item.age[i] < 0 ? "bad" : item.age[i] > 0.2 ? "care" : "")));
    const lost = item.losses.map(([name, n]) => made("span", `${name} ${n}`, "care"));
    $("losses").replaceChildren(...(lost.length ? lost : [made("span", "nothing", "good")]));
    if (item.carried) $("losses").append(made("span", `${item.carried} rows carried through tracker gaps`));
    text($("counts"), item.frozen ? "frozen: nothing is learnt" : "");
  }

  const HEADLINES = { good: "Good: everything arrives and fits", care: "With care", stop: "Stop" };
  function drawState() {
    $("verdict").className = state.heard ? state.verdict : "";
    text($("headline"), state.heard ? HEADLINES[state.verdict] : "Waiting for messages");
    $("findings").replaceChildren(...state.findings.map(([severity, says, action]) => {
      const line = made("li", "", severity);
      line.append(made("b", severity), ` ${says}`);
      if (action) line.append(made("span", action));
      return line;
    }));
    if (state.undecodable) $("findings").append(made("li", `${state.undecodable} messages could not be decoded: of another version, or no messages`));
  }

  function drawLink() {
    const away = performance.now() - heard;
    const [word, kind] = away > 3000 ? ["reconnecting", "bad"]
      : !state?.heard ? ["waiting", "care"]
      : state.note ? [state.note, state.note === "recording" ? "good" : "care"]
      : state.silence > 2 ? [`silent for ${state.silence.toFixed(0)} s`, "bad"] : ["live", "good"];
    text($("link"), word);
    $("link").className = `pill ${kind}`;
    text($("time"), end ? `${end.toFixed(1)} s` : "");
  }

  // ---- charts --------------------------------------------------------------------------------------------------------

  const shared = () => ({ end, span: shown.span, marks: shown.marks });
  const band = (items, low, high) => items.map((item) => [item.t, low(item), high(item)]);

  function drawParameters() {
    [...$("parameters").children].forEach((cell, i) => {
      const k = factor(i), items = tracks.estimate.items;
      const lines = [
        { points: band(items, (x) => k * (x.value[i] - 2 * x.std[i]), (x) => k * (x.value[i] + 2 * x.std[i])), color: style("--estimate"), band: 0.2, width: 1.6, gap: 5 },
      ];
      const reference = shown.robot && k * shown.robot.nominal[i];
      const rules = shown.robot ? [{ y: reference, color: style("--truth") }] : [];
      drawChart(cell.querySelector("canvas"), { ...shared(), lines, rules, range: settledRange(lines[0].points) }, style);
    });
  }

  function drawCables() {
    const rows = tracks.row.items, robot = shown.robot;
    const n = rows.length ? rows[rows.length - 1].low.length : 0;
    const cable = (items, low, high) => Array.from({ length: n }, (_, i) => (
      { points: band(items.filter((x) => (x.low ?? x.f).length === n), (x) => low(x)[i], (x) => high(x)[i]), color: SERIES[i % SERIES.length], width: 1.2, gap: 1.5, band: 0.35 }));
    drawChart($("force"), { ...shared(), lines: cable(rows, (x) => x.low, (x) => x.high), include: [0], least: 1 }, style);
    const left = tracks.residual.items;
    drawChart($("residual"), { ...shared(), lines: cable(left, (x) => x.f, (x) => x.f).map((x) => ({ ...x, band: 0 })), include: [0], least: 1 }, style);
    if (!robot || n !== robot.anchors.length) return;
    drawGauges(rows, n);
    const last = left[left.length - 1];
    const most = Math.max(1, ...left.flatMap((x) => x.f));
    if (last?.f.length === n) last.f.forEach((f, i) => bars.set(i, { from: 0, to: f / most, color: SERIES[i % SERIES.length], text: `${f.toFixed(f < 10 ? 1 : 0)} N` }));
    ends("bars", "0", `${most.toFixed(most < 10 ? 1 : 0)} N`);
  }

  function ends(box, low, high) {
    const [a, b] = $(box).lastElementChild.children;
    text(a, low); text(b, high);
  }

  function drawGauges(rows, n) {
    const now = shown.pose?.f ?? rows[rows.length - 1].high, limits = shown.robot.limits;
    for (let i = 0; i < n; i += 1) {
      const of = (f) => { const s = tensionShare(f, limits[i]); return s < 0 ? 0 : Math.min(s, 1); };
      const share = tensionShare(now[i], limits[i]);
      const color = share < 0 ? style("--slack") : share > 1 ? style("--bad") : rampColor(share);
      const low = Math.min(...rows.map((x) => x.low[i])), high = Math.max(...rows.map((x) => x.high[i]));
      gauges.set(i, { from: of(low), to: of(high), mark: of(now[i]), color, text: `${now[i].toFixed(0)} N` });
    }
    const [low, high] = [Math.min(...limits.map((x) => x[0])), Math.max(...limits.map((x) => x[1]))];
    ends("gauges", `min ${low} N`, `max ${high} N`);
  }

  function drawSensors() {
    const rows = tracks.row.items;
    const three = (key, k) => AXES.map(([, color], i) => ({ points: band(rows, (x) => k * x[key][i], (x) => k * x[key][i]), color, width: 1.3, gap: 1.5 }));
    drawChart($("acc"), { ...shared(), lines: three("acc", 1), least: 1 }, style);
    drawChart($("gyro"), { ...shared(), lines: three("gyro", DEGREES), least: 1 }, style);
    const gaps = [{ points: band(rows.filter((x) => x.gap !== null), (x) => 1e3 * x.gap, (x) => 1e3 * x.gap), color: style("--estimate"), width: 1.3, gap: 1.5 }];
    drawChart($("gap"), { ...shared(), lines: gaps, include: [0], least: 1 }, style);
  }

  function drawCharts() { drawParameters(); drawCables(); drawSensors(); drawLink(); }
  function drawRamp() {
    $("ramp").style.background = `linear-gradient(90deg, ${[0, 0.2, 0.4, 0.55, 0.7, 0.85, 1].map((s) => rampColor(s)).join(",")})`;
  }

  function drawAll() { view.draw(); drawCharts(); }

  // ---- stream --------------------------------------------------------------------------------------------------------

  function open() {
    stream?.close();
    heard = performance.now();
    stream = new EventSource("events");
    stream.onopen = () => { heard = performance.now(); };
    stream.onmessage = (message) => {
      heard = performance.now();
      for (const item of JSON.parse(message.data)) take[item.kind]?.(item);
    };
    stream.onerror = () => { if (stream.readyState === EventSource.CLOSED) setTimeout(open, 1000); };
  }

  function tick() {
    if (isPoseNew) { isPoseNew = false; view.draw(); }
    document.documentElement.dataset.frames = String(view.nDrawn);
    requestAnimationFrame(tick);
  }

  setInterval(() => {
    drawLink();
    if (performance.now() - heard > SILENCE) open();
    if (!document.hidden) drawCharts();
  }, CHART_PERIOD);

  // ---- controls ------------------------------------------------------------------------------------------------------

  for (const [id, isNear] of [["far", false], ["near", true]]) {
    $(id).addEventListener("click", () => {
      view.setView(isNear);
      $("near").setAttribute("aria-pressed", String(isNear)); $("far").setAttribute("aria-pressed", String(!isNear));
    });
  }

  async function send(name, note) {
    text($("answer"), `${name} …`);
    try {
      const reply = await fetch("command", { method: "POST", headers: { "Content-Type": "application/json", "X-Token": token },
                                             body: JSON.stringify({ name, text: note }) });
      text($("answer"), reply.ok ? (await reply.json()).answer : `${name} refused: ${(await reply.text()).trim()}`);
    } catch (error) {
      text($("answer"), `${name}: the page's server does not answer`);
    }
  }

  let armed = 0;
  for (const button of document.querySelectorAll("[data-command]")) {
    button.addEventListener("click", () => {
      const name = button.dataset.command;
      if (name === "reset" && performance.now() > armed) {  // what was learnt cannot be brought back
        armed = performance.now() + 4000;
        text(button, "Reset: click again");
        setTimeout(() => text(button, "Reset"), 4000);
        return;
      }
      armed = 0;
      send(name, null);
    });
  }
  $("mark").addEventListener("submit", (event) => {
    event.preventDefault();
    if ($("text").value.trim()) send("mark", $("text").value.trim()).then(() => { $("text").value = ""; });
  });
  if (!shown.isCommanding) {
    $("control").querySelectorAll("button, input").forEach((node) => { node.disabled = true; });
    text($("answer"), "Off: only a page on the daemon's own machine may command, and a recording takes none.");
  }

  document.querySelector(".axes").replaceChildren(...AXES.map(([name, color]) => {
    const key = made("span", name), line = made("i", "", "line");
    line.style.color = color;
    key.prepend(line);
    return key;
  }));
  new ResizeObserver(() => drawAll()).observe($("view"));
  window.addEventListener("resize", drawAll);
  drawAll();
  open();
  tick();
})();
