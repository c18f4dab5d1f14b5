// Keeps an open page as true as a fresh one: asks every second whether anything changed, and takes over the new <main>.
"use strict";
{
  const POLL_MS = 1000;
  const ANSWER_MS = 10000;  // a service that hangs is lost as one that is gone
  const root = document.documentElement;
  const connection = document.getElementById("connection");
  let lostAt = null;
  let timer = null;

  const clock = moment => moment.toLocaleTimeString(root.lang, { hour: "2-digit", minute: "2-digit" });

  function say() {
    connection.classList.toggle("lost", lostAt !== null);
    const words = lostAt === null ? `● ${document.body.dataset.live}` : `✕ ${document.body.dataset.lost.replace("{time}", clock(lostAt))}`;
    if (connection.textContent !== words) connection.textContent = words;
  }

  // Moments in the zone of the browser, ages as they are now; the server wrote both for those without a script.
  const UNITS = [["year", 31557600], ["month", 2629800], ["week", 604800], ["day", 86400], ["hour", 3600], ["minute", 60], ["second", 1]];
  const ages = new Intl.RelativeTimeFormat(root.lang, { style: "short", numeric: "always" });

  function age(seconds) {
    const [unit, length] = UNITS.find(([, size]) => Math.abs(seconds) >= size) || UNITS[UNITS.length - 1];
    return ages.format(-Math.floor(Math.abs(seconds) / length) * Math.sign(seconds), unit);
  }

  function local(moment) {
    const two = number => String(number).padStart(2, "0");
    const zone = new Intl.DateTimeFormat(root.lang, { timeZoneName: "short" }).formatToParts(moment).find(part => part.type === "timeZoneName").value;
    return `${moment.getFullYear()}-${two(moment.getMonth() + 1)}-${two(moment.getDate())} ${two(moment.getHours())}:${two(moment.getMinutes())} ${zone}`;
  }

  function tell() {
    for (const time of document.querySelectorAll("time[data-age]")) time.textContent = age((Date.now() - Date.parse(time.dateTime)) / 1000);
    for (const field of document.querySelectorAll("input[data-utc]")) {
      if (field.value === field.defaultValue && field.dataset.utc) {
        const moment = new Date(field.dataset.utc);
        field.defaultValue = field.value = new Date(moment - moment.getTimezoneOffset() * 60000).toISOString().slice(0, 16);
      }
      field.removeAttribute("data-utc");
    }
    for (const zone of document.querySelectorAll("input[name=zone]")) zone.value = Intl.DateTimeFormat().resolvedOptions().timeZone;
    for (const name of document.querySelectorAll("[data-zone]")) name.textContent = Intl.DateTimeFormat().resolvedOptions().timeZone;
    for (const time of document.querySelectorAll("time[data-local]")) {
      time.textContent = local(new Date(time.dateTime));
      time.removeAttribute("data-local");
    }
  }

  // What a person has opened, typed and looks at stays as it is.
  const keyOf = element => element.id || (element.name && `${element.form ? element.form.getAttribute("action") : ""} ${element.name}`);
  const fields = place => [...place.querySelectorAll("input:not([type=hidden]):not([type=file]), select, textarea")];
  const wasTouched = field => field.type === "checkbox" || field.type === "radio" ? field.checked !== field.defaultChecked
    : field.tagName === "SELECT" ? [...field.options].some(option => option.selected !== option.defaultSelected) : field.value !== field.defaultValue;

  function takeOver(fresh) {
    const old = document.querySelector("main"), next = fresh.querySelector("main"), active = document.activeElement;
    const opened = new Map([...old.querySelectorAll("details[id]")].map(element => [element.id, element.open]));
    const touched = new Map(fields(old).filter(wasTouched).map(field => [`${keyOf(field)} ${field.type === "radio" ? field.value : ""}`, field]));
    const focus = old.contains(active) ? active.id || active.getAttribute("href") || keyOf(active) : null;
    const selection = focus && "selectionStart" in active ? [active.selectionStart, active.selectionEnd] : null;
    const scroll = [scrollX, scrollY];
    const chosen = [...old.querySelectorAll("input[type=file][id]")].filter(field => field.files.length);
    old.replaceChildren(...next.childNodes);
    for (const field of chosen) document.getElementById(field.id)?.replaceWith(field);  // no script may choose a file
    for (const element of old.querySelectorAll("details[id]")) if (opened.has(element.id)) element.open = opened.get(element.id);
    for (const field of fields(old)) {
      const typed = touched.get(`${keyOf(field)} ${field.type === "radio" ? field.value : ""}`);
      if (typed) field.type === "checkbox" || field.type === "radio" ? field.checked = typed.checked : field.value = typed.value;
    }
    const same = focus && [...old.querySelectorAll("a, button, input, select, textarea, summary, [tabindex]")].find(element =>
      (element.id || element.getAttribute("href") || keyOf(element)) === focus);
    if (same) {
      same.focus({ preventScroll: true });
      if (selection && selection[0] !== null) same.setSelectionRange(...selection);
    }
    scrollTo(...scroll);
    document.title = fresh.title;
    root.dataset.mark = fresh.documentElement.dataset.mark;
    tell();
    document.dispatchEvent(new Event("takenover"));
  }

  const get = (address, headers) => fetch(address, { cache: "no-store", headers, signal: AbortSignal.timeout(ANSWER_MS) });

  async function ask() {
    clearTimeout(timer);
    try {
      const answer = await get(`/v1/changes?since=${encodeURIComponent(root.dataset.mark)}`);
      if (answer.status === 401) location.reload();
      else if (answer.status === 200) {
        const page = await get(location.href, { Accept: "text/html" });
        if (page.redirected) location.assign(page.url);
        else if (page.status >= 500 && page.status !== 500) throw new Error(`the service answered ${page.status}`);
        else takeOver(new DOMParser().parseFromString(await page.text(), "text/html"));
      } else if (answer.status !== 304) throw new Error(`the service answered ${answer.status}`);
      lostAt = null;
    } catch {
      lostAt = lostAt || new Date();
    }
    say();
    timer = setTimeout(ask, POLL_MS);
  }

  // A page that says what was done says it once: to load it again does not.
  const address = new URL(location.href);
  if (address.searchParams.has("done")) {
    address.searchParams.delete("done");
    history.replaceState(null, "", address);
  }
  tell();
  say();
  setInterval(tell, 1000);
  addEventListener("visibilitychange", () => { if (!document.hidden) ask(); });
  if (root.dataset.mark) ask();
}
