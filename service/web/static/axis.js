// Draws the trend of one axis and keeps it fresh. The page says what the marks mean.
"use strict";

const REFRESH_MS = 3000;
const STATE_COLOUR = { normal: "#2e7d4f", learning: "#5b6875", unknown: "#8a6d00", alert: "#c26a00", alarm: "#b3261e" };

const holder = document.getElementById("preload-chart");
const axis = holder.dataset.axis;
let points = [];
let etag = null;
const charts = [];
const baseline = holder.dataset.baseline ? holder.dataset.baseline.split(" ").map(Number) : null;

async function fetchTrend() {
  const response = await fetch(`/v1/axes/${encodeURIComponent(axis)}/trend?limit=10000&max_points=4000`,
    { headers: etag ? { "If-None-Match": etag } : {}, cache: "no-store" });
  if (response.status === 304) return false;
  etag = response.headers.get("ETag");
  points = (await response.json()).points;
  return true;
}

const seconds = () => points.map(p => Date.parse(p.at) / 1000);
const values = key => points.map(p => p[key]);
const bound = i => points.map(p => (p.interval_95_n ? p.interval_95_n[i] : null));

const line = holder.dataset.line ? holder.dataset.line.split(" ") : null;
const MS_PER_YEAR = 365.25 * 86400e3;

function drawLine(u) {
  if (!line) return;
  const [start, end] = line.slice(0, 2).map(Date.parse);
  const [last, slope] = line.slice(2).map(Number);
  const first = last - slope * (end - start) / MS_PER_YEAR;
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
  ctx.strokeStyle = "#7a4ea3"; ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
  ctx.beginPath();
  ctx.moveTo(u.valToPos(start / 1000, "x", true), u.valToPos(first, "y", true));
  ctx.lineTo(u.valToPos(end / 1000, "x", true), u.valToPos(last, "y", true));
  ctx.stroke();
  ctx.restore();
}

function drawBaseline(u) {
  if (!baseline) return;
  const [mean, lower, upper] = baseline.map(value => u.valToPos(value, "y", true));
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
  ctx.fillStyle = "rgba(31, 95, 153, .10)"; ctx.fillRect(bbox.left, upper, bbox.width, lower - upper);
  ctx.strokeStyle = "rgba(31, 95, 153, .6)";
  ctx.beginPath(); ctx.moveTo(bbox.left, mean); ctx.lineTo(bbox.left + bbox.width, mean); ctx.stroke();
  ctx.restore();
}

function drawMarks(u, seriesIndex, filled) {
  const { ctx } = u;
  ctx.save();
  points.forEach((p, i) => {
    const value = u.data[seriesIndex][i];
    const x = u.valToPos(u.data[0][i], "x", true);
    const refused = p.status === "refused";
    if (value == null && !refused) return;
    const y = value == null ? u.bbox.top + u.bbox.height - 8 * devicePixelRatio : u.valToPos(value, "y", true);
    ctx.strokeStyle = ctx.fillStyle = STATE_COLOUR[p.state] || "#5b6875";
    if (!refused && filled && p.interval_95_n) {
      const top = p.interval_95_n[1] == null ? u.bbox.top : u.valToPos(p.interval_95_n[1], "y", true);
      ctx.globalAlpha = 0.45;
      ctx.beginPath(); ctx.moveTo(x, u.valToPos(p.interval_95_n[0], "y", true)); ctx.lineTo(x, top); ctx.stroke();
      ctx.globalAlpha = 1;
    }
    const r = 3.2 * devicePixelRatio;
    ctx.beginPath();
    if (p.doubt) { ctx.moveTo(x - r, y - r); ctx.lineTo(x + r, y + r); ctx.moveTo(x - r, y + r); ctx.lineTo(x + r, y - r); }
    else ctx.arc(x, y, r, 0, 2 * Math.PI);
    if (refused || p.doubt) ctx.stroke(); else ctx.fill();
  });
  ctx.restore();
}

function makeChart(id, label, series, seriesIndex, filled, height) {
  const element = document.getElementById(id);
  const chart = new uPlot({
    width: element.clientWidth, height,
    scales: { x: { time: true } },
    axes: [{}, { label, size: 70 }],
    series: [{ label: "time (UTC)" }, ...series],
    tzDate: seconds => uPlot.tzDate(new Date(seconds * 1e3), "Etc/UTC"),
    hooks: { draw: [u => { if (filled) { drawBaseline(u); drawLine(u); } drawMarks(u, seriesIndex, filled); }] },
  }, [[], ...series.map(() => [])], element);
  charts.push({ chart, element, height });
  return chart;
}

const plain = { paths: () => null, points: { show: false } };
const preload = makeChart("preload-chart", "preload / N", [
  { label: "preload / N", stroke: "#1f5f99", ...plain, value: (_, v) => (v == null ? "—" : v.toFixed(0)) },
  { label: "lower 95 %", stroke: "#9db7cf", ...plain, value: (_, v) => (v == null ? "—" : v.toFixed(0)) },
  { label: "upper 95 %", stroke: "#9db7cf", ...plain, value: (_, v) => (v == null ? "—" : v.toFixed(0)) },
], 1, true, 340);
const frequency = makeChart("frequency-chart", "frequency / Hz", [
  { label: "frequency / Hz", stroke: "#1f5f99", ...plain, value: (_, v) => (v == null ? "—" : v.toFixed(2)) },
], 1, false, 220);

const drag = makeChart("drag-chart", "drag torque / N·m", [
  { label: "drag torque / N·m", stroke: "#1f5f99", ...plain, value: (_, v) => (v == null ? "—" : v.toFixed(3)) },
], 1, false, 200);

function listRefusals() {
  const body = document.getElementById("refused");
  const rows = points.filter(p => p.status === "refused").slice(-20).reverse();
  if (!rows.length) return;
  body.replaceChildren(...rows.map(p => {
    const row = document.createElement("tr");
    for (const text of [`${p.at.slice(0, 16).replace("T", " ")} UTC, ${p.position_mm.toFixed(0)} mm`, p.refusal_reason]) {
      row.appendChild(document.createElement("td")).textContent = text;
    }
    return row;
  }));
}

// A cause is found some seconds after its alarm was raised, and anew while more is measured.
async function lookForCauses() {
  if (!document.querySelector("[data-alarm]")) return;
  const response = await fetch(`/v1/alarms?axis=${encodeURIComponent(axis)}`, { cache: "no-store" });
  for (const alarm of (await response.json()).alarms) {
    const cell = document.querySelector(`[data-alarm="${alarm.id}"]`);
    if (cell && cell.textContent !== alarm.explanation.sentence) location.reload();
  }
}

async function refresh() {
  try {
    await lookForCauses();
    if (await fetchTrend()) {
      const t = seconds();
      preload.setData([t, values("preload_n"), bound(0), bound(1)]);
      frequency.setData([t, values("frequency_hz")]);
      drag.setData([t, values("drag_torque_nm")]);
      listRefusals();
      const last = points[points.length - 1];
      const state = document.getElementById("state");
      if (last && last.state && state.textContent !== last.state && state.textContent !== "unknown") location.reload();
    }
  } finally {
    setTimeout(refresh, REFRESH_MS);
  }
}

addEventListener("resize", () => charts.forEach(({ chart, element, height }) =>
  chart.setSize({ width: element.clientWidth, height })));
refresh();
