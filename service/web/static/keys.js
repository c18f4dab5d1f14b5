// Arrow keys lead to the neighbours of a page, and a button prints it. The links and the browser do both without this.
"use strict";
{
  document.addEventListener("keydown", event => {
    if (event.altKey || event.ctrlKey || event.metaKey || event.shiftKey) return;
    if (event.target.closest("input, select, textarea, [tabindex='0']")) return;
    const rel = { ArrowLeft: "prev", ArrowRight: "next" }[event.key];
    const link = rel && document.querySelector(`main a[rel=${rel}]`);
    if (link) link.click();
  });
  document.addEventListener("click", event => {
    if (event.target.closest("button[data-print]")) print();
  });
}
