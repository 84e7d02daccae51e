// The page shows what the server tells, and sends it orders: "stop" to a rig; "play", "pause" and "seek" to a bag.
"use strict";

const $ = (id) => document.getElementById(id);
const SILENCE_MS = 3000;       // the server says something every second: after so long the connection is dead
const SECONDS = 10;            // the length of the traces, as in drawn_beam.py
const parts = {};              // newest content of each part
const rows = { hub: [], tip: [], log: [] };
let socket = null, isBag = false, isSeeking = false, awaitsStop = null, heardAt = 0;

// --- words and tables: whatever comes from the rig is set as text, never as markup

function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function digits(value, n) {
  return value === null || value === undefined ? "–" : value.toFixed(n);
}

// A value with as many decimals as its standard deviation has two digits.
function withSd(value, sd) {
  if (sd === null || sd === undefined || !(sd > 0)) return [value.toPrecision(6), "not known"];
  const decimals = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(sd))));
  return [value.toFixed(decimals), sd.toFixed(decimals)];
}

function fill(table, lines) {
  const body = document.createElement("tbody");
  for (const line of lines) {
    const row = body.insertRow();
    line.forEach((cell, k) => {
      const [text, level] = Array.isArray(cell) ? cell : [cell, ""];
      const element = document.createElement(k === 0 ? "th" : "td");
      if (k === 0) element.scope = "row";
      element.textContent = text;
      if (level) element.className = level;
      row.append(element);
    });
  }
  table.tBodies[0].replaceWith(body);
}

// --- charts

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function axis(label) {
  return {
    stroke: () => colour("soft"), grid: { stroke: () => colour("line"), width: 1 },
    ticks: { stroke: () => colour("line") }, label, labelSize: 18, labelGap: 0, size: label ? 46 : 28,
    font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
  };
}

function limitLines(limitOf) {
  return (chart) => {
    const limit = limitOf();
    if (!limit) return;
    const { left, width, top, height } = chart.bbox;
    chart.ctx.save();
    chart.ctx.strokeStyle = colour("limit");
    chart.ctx.lineWidth = devicePixelRatio * 1.5;
    chart.ctx.setLineDash([2 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const value of [-limit, limit]) {
      const y = chart.valToPos(value, "y", true);
      if (y < top || y > top + height) continue;
      chart.ctx.beginPath();
      chart.ctx.moveTo(left, y);
      chart.ctx.lineTo(left + width, y);
      chart.ctx.stroke();
    }
    chart.ctx.restore();
  };
}

// Half of the limit is always in sight; what comes near it brings the limit itself in.
function rangeWithin(limitOf) {
  return (_chart, low, high) => {
    const largest = Math.max(Math.abs(low || 0), Math.abs(high || 0));
    const limit = limitOf() || 1;
    const half = largest > 0.4 * limit ? 1.1 * Math.max(limit, largest) : Math.max(1.25 * largest, 0.02 * limit);
    return [-half, half];
  };
}

function traceChart(element, series, limitOf) {
  const chart = new uPlot({
    width: element.clientWidth || 300, height: 180, legend: { show: false }, cursor: { show: false }, pxAlign: false,
    scales: { x: { time: false, range: (_c, low, high) => [low || 0, Math.max((low || 0) + SECONDS, high || 0)] },
              y: { range: rangeWithin(limitOf) } },
    axes: [axis(""), axis("mm")],
    series: [{}, ...series],
    hooks: { draw: [limitLines(limitOf)] },
  }, [[], ...series.map(() => [])], element);
  new ResizeObserver(() => chart.setSize({ width: element.clientWidth, height: 180 })).observe(element);
  return chart;
}

const MEASURED = () => ({ stroke: () => colour("measured"), width: 1.8, points: { show: false }, spanGaps: false });
const PREDICTED = () => ({ stroke: () => colour("predicted"), width: 1.4, dash: [6, 4], points: { show: false },
                           spanGaps: true });
const hubLimit = () => parts.beam && parts.beam.hub_limit;
const tipLimit = () => parts.beam && parts.beam.tip_limit;
let hubChart, tipChart, responseChart;

function makeCharts() {
  hubChart = traceChart($("hub-chart"), [MEASURED()], hubLimit);
  tipChart = traceChart($("tip-chart"), [MEASURED(), PREDICTED()], tipLimit);
  const element = $("response-chart");
  const hidden = { show: true, stroke: "transparent", width: 0, points: { show: false } };
  responseChart = new uPlot({
    width: element.clientWidth || 300, height: 300, legend: { show: false }, cursor: { drag: { x: true, y: false } },
    scales: { x: { time: false }, y: { distr: 3 } },
    axes: [{ ...axis("frequency [Hz]"), size: 40 }, { ...axis("|displacement / hub|"), size: 60 }],
    series: [{}, hidden, hidden,
             { stroke: () => colour("model"), width: 2, points: { show: false } },
             { stroke: () => colour("measured"), width: 0, paths: () => null,
               points: { show: true, size: 5, width: 0, fill: () => colour("measured") } }],
    bands: [{ series: [1, 2], fill: () => colour("band") }],
  }, [[], [], [], [], []], element);
  new ResizeObserver(() => responseChart.setSize({ width: element.clientWidth, height: 300 })).observe(element);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const chart of [hubChart, tipChart, responseChart]) chart.redraw(false, true);
  });
}

function columns(name, count) {
  const table = Array.from({ length: count }, () => []);
  for (const row of rows[name]) for (let k = 0; k < count; k += 1) table[k].push(row[k]);
  return table;
}

function largest(values) {
  let found = 0;
  for (const value of values) if (value !== null && Math.abs(value) > found) found = Math.abs(value);
  return found;
}

function drawTraces() {
  const [at, hub, predicted] = columns("hub", 3);
  const tip = columns("tip", 2);
  hubChart.setData([at, hub]);
  tipChart.setData(uPlot.join([tip, [at, predicted]], [[1], [2]]));
}

function describeTraces() {
  const hub = columns("hub", 2)[1], tip = columns("tip", 2)[1];
  const words = (values, limit) => values.length
    ? `now ${digits(values[values.length - 1], 2)} mm, largest ${digits(largest(values), 2)} mm, limit ± ${digits(limit, 1)} mm`
    : "nothing measured";
  say($("hub-note"), words(hub, hubLimit()));
  say($("tip-note"), words(tip, tipLimit()));
}

// --- the beam

const SVG = "http://www.w3.org/2000/svg";
const drawn = {};

function drawing(kind, attributes) {
  const element = document.createElementNS(SVG, kind);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function shapeOf(kind, name, attributes) {
  if (!drawn[name]) {
    drawn[name] = drawing(kind, {});
    $("beam").append(drawn[name]);
  }
  for (const [key, value] of Object.entries(attributes)) drawn[name].setAttribute(key, value);
  return drawn[name];
}

// Bending is small beside the beam's length: it is drawn larger by a whole step where the limits leave room.
function magnification(beam) {
  for (const factor of [10, 5, 2]) if (factor * beam.tip_limit <= 0.35 * beam.length) return factor;
  return 1;
}

function drawBeam() {
  const beam = parts.beam, shape = parts.shape;
  if (!beam || !shape) return;
  const factor = magnification(beam);
  const half = beam.hub_limit + factor * beam.tip_limit + 12, foot = 0.12 * beam.length, head = 0.1 * beam.length;
  shapeOf("g", "ground", {});
  $("beam").setAttribute("viewBox", `${-half} ${-beam.length - head} ${2 * half} ${beam.length + head + foot}`);
  const hub = shape.hub === null ? (shape.measured ? shape.measured[0] : 0) : shape.hub;
  const x = (value) => hub + factor * (value - hub);
  const rail = 0.075 * beam.length, stop = 0.03 * beam.length, top = -beam.length - 0.05 * beam.length;
  const reach = factor * beam.tip_limit;
  shapeOf("path", "rail", { class: "limit", d: `M${-beam.hub_limit - 8} ${rail}H${beam.hub_limit + 8}` +
    `M${-beam.hub_limit - 8} ${rail}v${-stop}M${beam.hub_limit + 8} ${rail}v${-stop}` });
  shapeOf("path", "tip-limit", { class: "limit", "stroke-dasharray": "2 4",
    d: `M${hub - reach} ${top}v${2 * stop}M${hub + reach} ${top}v${2 * stop}` });
  shapeOf("rect", "hub", { class: "hub", x: hub - 8, y: 0, width: 16, height: rail - 2, rx: 2 });
  for (const kind of ["measured", "predicted"]) {
    const line = shape[kind];
    const points = line ? line.map((value, k) => `${x(value).toFixed(2)},${-shape.heights[k]}`).join(" ") : "";
    shapeOf("polyline", kind, { class: kind, points });
  }
  beam.names.forEach((name, k) => {
    const at = shape.markers[k];
    shapeOf("circle", `marker ${k}`, { class: "marker", r: 0.014 * beam.length, cx: at === null ? 0 : x(at),
      cy: -beam.marker_heights[k], visibility: at === null ? "hidden" : "visible" });
    shapeOf("text", `name ${k}`, { x: -half + 2, y: -beam.marker_heights[k] + 3 }).textContent =
      at === null ? `${name} not seen` : name;
  });
  drawn.factor = factor;
}

function describeBeam() {
  const beam = parts.beam, shape = parts.shape;
  if (!beam || !shape) return;
  const unseen = beam.names.filter((_name, k) => shape.markers[k] === null);
  $("beam").setAttribute("aria-label", `The beam: hub at ${digits(shape.hub, 1)} mm, tip bent by ${digits(shape.tip, 1)} mm.`);
  const drawnAs = drawn.factor > 1 ? `Bending is drawn ${drawn.factor} times as large. ` : "";
  const lost = unseen.length && shape.measured ? `Not seen: ${unseen.join(", ")}. ` : "";
  say($("beam-note"), `${drawnAs}${lost}Beam and limits: ${beam.rig}.`);
  const speed = shape.speed === null || shape.speed === undefined ? "" :
    Math.abs(shape.speed) < 0.05 ? ", at rest" : `, ${digits(shape.speed, 1)} mm/s`;
  say($("motion"), shape.hub === null ? "not heard" : `${digits(shape.hub, 2)} mm${speed}`);
}

// --- the camera

async function drawPicture(buffer) {
  const length = new DataView(buffer).getUint32(0);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const bitmap = await createImageBitmap(new Blob([new Uint8Array(buffer, 4 + length)], { type: "image/jpeg" }));
  // Names and circles are as sharp over a small picture as over a large one.
  const canvas = $("picture"), larger = Math.max(1, Math.round(600 / Math.max(bitmap.width, bitmap.height)));
  const width = larger * bitmap.width, share = width / about.width;
  canvas.width = width;
  canvas.height = larger * bitmap.height;
  const pen = canvas.getContext("2d");
  pen.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  pen.strokeStyle = "#7cc4ff";
  pen.fillStyle = "#7cc4ff";
  const side = Math.max(canvas.width, canvas.height);
  pen.lineWidth = side / 400;
  pen.font = `${Math.round(side / 32)}px system-ui, sans-serif`;
  const radius = side / 45, names = parts.beam ? parts.beam.names : [];
  for (const marker of about.markers) {
    const x = (marker.u + 0.5) * share, y = (marker.v + 0.5) * share;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.moveTo(x - 1.6 * radius, y);
    pen.lineTo(x + 1.6 * radius, y);
    pen.stroke();
    const name = names[marker.id] || "", room = x + 1.8 * radius + pen.measureText(name).width < canvas.width;
    pen.textAlign = room ? "left" : "right";
    pen.fillText(name, room ? x + 1.8 * radius : x - 1.8 * radius, y - 0.6 * radius);
  }
  $("camera").hidden = false;
  const words = about.markers.length ? `${about.markers.length} markers found` : "no marker of this frame is known";
  say($("camera-note"), `${about.width} × ${about.height} px; ${words}`);
  bitmap.close();
}

// --- the estimate

function drawResponse() {
  const live = parts.identification, response = live && live.response, choice = $("output");
  const names = response ? Object.keys(response.outputs) : [];
  if (names.join() !== Array.from(choice.options, (option) => option.value).join()) {
    const before = choice.value;
    choice.replaceChildren(...names.map((name) => new Option(name, name)));
    choice.value = names.includes(before) ? before : names[names.length - 1] || "";
  }
  if (!response || !choice.value) {
    responseChart.setData([[], [], [], [], []]);
    say($("response-note"), "No response is known yet.");
    return;
  }
  const curves = response.outputs[choice.value];
  const positive = (value) => (value > 0 ? value : null);
  const band = (sign) => curves.model.map((value, k) => {
    const sd = curves.model_sd[k];
    if (value === null || sd === null) return null;
    return sign > 0 ? positive(value + 2 * sd) : Math.max(value - 2 * sd, value * 1e-3);
  });
  responseChart.setData([response.frequency_hz, band(1), band(-1), curves.model.map(positive),
                         curves.measured.map(positive)]);
  const shares = curves.model.flatMap((value, k) => value > 0 && curves.model_sd[k] !== null ? [curves.model_sd[k] / value] : []);
  shares.sort((a, b) => a - b);
  const half = shares.length ? `; half of the model's values are known to ${(100 * shares[shares.length >> 1]).toPrecision(2)} %` : "";
  say($("response-note"), `${choice.value} over ${response.input}${half}.`);
}

// The theory's shape at a height, in a straight line between the heights at which it is given.
function shapeAt(theory, mode, height) {
  const { heights, shapes } = theory, last = heights.length - 1;
  const place = last * (height - heights[0]) / (heights[last] - heights[0]);
  const below = Math.min(last - 1, Math.max(0, Math.floor(place)));
  return shapes[mode][below] + (place - below) * (shapes[mode][below + 1] - shapes[mode][below]);
}

// Of a mode of theory the size is free: it is the one that fits the identified mode at the markers.
function shapePlot(values, heights, theory, mode) {
  const expected = heights.map((height) => shapeAt(theory, mode, height));
  const sum = (pairs) => pairs.reduce((total, [a, b]) => total + a * b, 0);
  const size = sum(values.map((value, k) => [value, expected[k]])) / (sum(expected.map((value) => [value, value])) || 1);
  const curve = theory.shapes[mode].map((value) => size * value);
  const half = 1.15 * Math.max(largest(values), largest(curve)), top = theory.heights[theory.heights.length - 1];
  const x = (value) => (40 * value / half).toFixed(2), y = (height) => (100 * (1 - height / top)).toFixed(2);
  const plot = drawing("svg", { viewBox: "-45 -5 90 110", "aria-hidden": "true" });
  plot.append(drawing("path", { class: "limit", d: "M0 0V100M-45 100H45" }),
    drawing("polyline", { class: "predicted", points: curve.map((value, k) => `${x(value)},${y(theory.heights[k])}`).join(" ") }),
    ...values.map((value, k) => drawing("circle", { class: "marker", r: 3.2, cx: x(value), cy: y(heights[k]) })));
  const apart = Math.max(...values.map((value, k) => Math.abs(value - size * expected[k]))) / (largest(values) || 1);
  return [plot, apart];
}

function drawShapes() {
  const live = parts.identification, shape = live && live.shape, theory = parts.beam && parts.beam.theory;
  $("shapes").classList.toggle("none", !shape || !theory);
  if (!shape || !theory) return;
  const heights = shape.heights_m.map((height) => 1000 * height), words = [];
  $("shape-plots").replaceChildren(...shape.modes.map((values, k) => {
    const hertz = live.modes[k].frequency_hz;
    const apartFrom = (own) => Math.abs(Math.log(own / hertz));
    const mode = theory.frequency_hz.reduce((best, own, j) => (apartFrom(own) < apartFrom(theory.frequency_hz[best]) ? j : best), 0);
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    const [plot, apart] = shapePlot(values, heights, theory, mode);
    caption.textContent = `${hertz.toPrecision(4)} Hz (${theory.frequency_hz[mode].toPrecision(4)} Hz)`;
    words.push(`mode ${k + 1} within ${(100 * apart).toPrecision(2)} %`);
    figure.append(plot, caption);
    return figure;
  }));
  say($("shapes-note"), `In brackets the frequency of the rig file's beam. Of its largest value at the markers, it agrees: ${words.join(", ")}.`);
}

function percent(share) {
  return share === null || share === undefined ? "not known" : `${(100 * share).toPrecision(2)} %`;
}

function drawIdentification() {
  const live = parts.identification;
  $("response").classList.toggle("none", !live || !live.response);
  $("assumptions").classList.toggle("none", !live || !live.tests.length);
  if (live) responseChart.setSize({ width: $("response-chart").clientWidth || 300, height: 300 });
  say($("live"), live ? live.sentence : isBag ? "Nothing is estimated yet."
    : "No estimate is under way, for no node live_identifier runs: `beam run live_identifier` starts it.");
  const modes = live ? live.modes : [], aims = live ? live.aims : [];
  $("modes").hidden = !modes.length;
  fill($("modes"), modes.map((mode, k) => [`${k + 1}`, ...withSd(mode.frequency_hz, mode.frequency_sd_hz),
    ...withSd(100 * mode.damping_ratio, mode.damping_ratio_sd === null ? null : 100 * mode.damping_ratio_sd)]));
  $("aims").hidden = !aims.length;
  fill($("aims"), aims.map((aim) => [aim.name, percent(aim.relative_sd_asked), percent(aim.relative_sd),
    aim.met ? ["reached", "good"] : aim.seconds_to_go === null ? ["not known", "doubt"] : `${digits(aim.seconds_to_go, 0)} s`]));
  const level = { holds: "good", fails: "bad", "not tested": "doubt" };
  fill($("tests"), (live ? live.tests : []).map((test) => [test.assumption, test.test,
    test.p === null ? "–" : test.p.toPrecision(2), [test.verdict, level[test.verdict]]]));
  drawResponse();
  drawShapes();
}

// --- state, tables, log

const LEVELS = { OK: "good", WARN: "doubt", STALE: "doubt", ERROR: "bad" };
const MARKS = { info: "", warning: "! ", error: "!! " };

function drawState() {
  const axisPart = parts.axis, fault = axisPart && axisPart.mode && axisPart.mode.fault;
  if (axisPart) {
    const silent = axisPart.silent ? " (nothing is heard of the hub)" : "";
    say($("axis"), isBag && !axisPart.mode ? "this bag does not say" : axisPart.words + silent);
  }
  $("fault").hidden = !fault;
  if (fault) say($("fault"), `Fault: ${fault.sentence}. What to do: ${fault.remedy || "see the page of faults"}.`);
  say($("sequence"), parts.sequence ? parts.sequence.words : "none");
  const recorder = parts.recorder;
  say($("recorder"), isBag && !recorder ? "this bag does not say" : !recorder || (!recorder.recording && !recorder.path) ? "not recording"
    : recorder.failure ? recorder.failure
    : `${recorder.recording ? "recording to" : "recorded"} ${recorder.path}: ${recorder.messages} messages, ${recorder.lost} lost`);
  if (awaitsStop) say($("answer"), `${awaitsStop} The axis now: ${axisPart ? axisPart.words : "not heard"}; hub ${$("motion").textContent}.`);
}

function drawTables() {
  fill($("losses"), (parts.losses || []).map((loss) => [loss.where, loss.what,
    [String(loss.count), loss.count ? "bad" : "good"]]));
  const nodes = parts.nodes || [];
  $("health").hidden = !nodes.length;
  fill($("nodes"), nodes.map((node) => [node.name, [node.level, LEVELS[node.level]], node.sentence]));
}

function drawLog() {
  $("log").replaceChildren(...rows.log.slice(-200).reverse().map((entry) => {
    const item = document.createElement("li"), time = document.createElement("time"), text = document.createElement("span");
    time.textContent = isBag ? `${entry.at.toFixed(2)} s` : new Date(1000 * entry.at).toLocaleTimeString();
    text.textContent = MARKS[entry.level] + entry.text;
    text.className = { warning: "doubt", error: "bad" }[entry.level] || "";
    item.append(time, text);
    return item;
  }));
}

function drawHead() {
  const beam = parts.beam;
  isBag = beam.source === "bag";
  say($("title"), beam.title);
  document.title = `${beam.title} – beam rig`;
  $("stop").hidden = isBag;
  $("player").hidden = !isBag;
}

function drawPlayer() {
  const player = parts.player;
  if (!player) return;
  say($("play"), player.playing ? "Pause" : "Play");
  $("seek").max = player.duration;
  if (!isSeeking) $("seek").value = player.position;
  say($("place"), `${digits(player.position, 1)} of ${digits(player.duration, 1)} s`);
  $("seek").setAttribute("aria-valuetext", `${digits(player.position, 1)} seconds`);
}

// --- the stream

const DRAWERS = { beam: [drawHead, drawBeam, drawShapes], shape: [drawBeam], identification: [drawIdentification], axis: [drawState],
  sequence: [drawState], recorder: [drawState], losses: [drawTables], nodes: [drawTables], player: [drawPlayer],
  log: [drawLog], hub: [drawTraces], tip: [drawTraces] };
const due = new Set();
let isPlanned = false;

function plan(name) {
  for (const drawer of DRAWERS[name] || []) due.add(drawer);
  if (isPlanned) return;
  isPlanned = true;
  requestAnimationFrame(() => {
    isPlanned = false;
    const drawers = [...due];
    due.clear();
    for (const drawer of drawers) drawer();
  });
}

function take(news) {
  if (news.answer) answered(news.answer);
  for (const [name, content] of Object.entries(news)) {
    if (name === "answer") continue;
    if (name in rows) {
      rows[name] = content.anew ? content.rows : rows[name].concat(content.rows);
      const kept = rows[name];
      if (name === "log") rows.log = kept.slice(-200);
      else if (kept.length) rows[name] = kept.filter((row) => row[0] >= kept[kept.length - 1][0] - SECONDS);
    } else parts[name] = content;
    plan(name);
  }
}

function order(name, value) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(value === undefined ? { order: name } : { order: name, value }));
  return true;
}

function stop() {
  if (isBag || $("stop").hidden) return;
  awaitsStop = order("stop") ? "Stop was asked for." :
    "Stop did not reach the rig: this page is not connected. Use the axis's own switch, or `beam call hub/stop`.";
  $("answer").hidden = false;
  say($("answer"), awaitsStop);
}

function answered(answer) {
  if (answer.order !== "stop" && answer.done) return;
  awaitsStop = answer.order === "stop" ? `${answer.done ? "Stop:" : "Stop failed:"} ${answer.text}.` : answer.text;
  $("answer").hidden = false;
  say($("answer"), awaitsStop);
  if (answer.order === "stop") drawState();
}

function connected(is, words) {
  document.body.classList.toggle("lost", !is);
  $("link").classList.toggle("lost", !is);
  say($("link"), words);
}

async function lost() {
  let words = "connection lost; trying again";
  try {
    const response = await fetch("/", { method: "HEAD" });
    if (response.status === 403) words = "this page's session is over: open the link that the terminal shows now";
  } catch { /* the server is not there: it may come back */ }
  connected(false, words);
  setTimeout(connect, 1000);
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(`${scheme}//${location.host}/news`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { heardAt = performance.now(); connected(true, "connected"); };
  socket.onmessage = (event) => {
    heardAt = performance.now();
    if (typeof event.data === "string") take(JSON.parse(event.data));
    else drawPicture(event.data).catch(() => { /* one frame that cannot be shown; the next one comes */ });
  };
  socket.onclose = lost;
}

// A network that is gone ends no connection by itself, and a stop into it would be lost without a word.
function watch() {
  if (socket.readyState !== WebSocket.OPEN || performance.now() - heardAt < SILENCE_MS) return;
  socket.onclose = socket.onmessage = null;
  socket.close();
  lost();
}

makeCharts();
$("stop").addEventListener("click", stop);
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat) stop();
});
$("play").addEventListener("click", () => order(parts.player && parts.player.playing ? "pause" : "play"));
$("seek").addEventListener("input", () => { isSeeking = true; order("seek", Number($("seek").value)); });
$("seek").addEventListener("change", () => { isSeeking = false; });
$("output").addEventListener("change", drawResponse);
setInterval(() => { watch(); describeTraces(); describeBeam(); if (awaitsStop) drawState(); }, 250);
connect();
