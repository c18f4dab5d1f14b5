// The trend by keyboard and by dragging. The server draws every picture; without this script its buttons zoom as well.
"use strict";
{
  const points = figure => [...figure.querySelectorAll(".wide a")];

  document.addEventListener("keydown", event => {
    const figure = event.target.closest && event.target.closest("figure.trend");
    const step = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity }[event.key];
    if (!figure || step === undefined) return;
    const all = points(figure), now = all.indexOf(document.activeElement);
    if (!all.length) return;
    event.preventDefault();
    const next = all[Math.min(Math.max(now < 0 ? all.length - 1 : now + step, 0), all.length - 1)];
    next.focus({ preventScroll: true });
    document.getElementById("reading").textContent = next.querySelector("title").textContent;
  });

  let dragged = null;
  const svgOf = figure => [...figure.querySelectorAll("svg")].find(svg => svg.getBoundingClientRect().width > 0);

  function moment(svg, clientX) {
    const box = svg.getBoundingClientRect(), { left, right, from, to } = svg.dataset;
    const x = (clientX - box.left) / box.width * svg.viewBox.baseVal.width;
    const part = Math.min(Math.max((x - left) / (right - left), 0), 1);
    return new Date(Date.parse(from) + part * (Date.parse(to) - Date.parse(from)));
  }

  document.addEventListener("pointerdown", event => {
    const figure = event.target.closest("figure.trend");
    if (!figure || event.button !== 0 || event.pointerType === "touch") return;
    event.preventDefault();
    const box = document.createElement("div");
    box.className = "zoom-box";
    figure.append(box);
    dragged = { figure, box, from: event.clientX, link: event.target.closest("a") };
  });
  document.addEventListener("pointermove", event => {
    if (!dragged) return;
    const edge = dragged.figure.getBoundingClientRect().left;
    dragged.box.style.left = `${Math.min(dragged.from, event.clientX) - edge}px`;
    dragged.box.style.width = `${Math.abs(event.clientX - dragged.from)}px`;
  });
  document.addEventListener("pointerup", event => {
    if (!dragged) return;
    const { figure, box, from } = dragged, svg = svgOf(figure);
    box.remove();
    dragged = null;
    if (!svg || Math.abs(event.clientX - from) < 12) return;
    const [start, end] = [from, event.clientX].sort((a, b) => a - b).map(x => moment(svg, x).toISOString());
    location.assign(`${location.pathname}?${new URLSearchParams({ from: start, to: end })}`);
  });
}
