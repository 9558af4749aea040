"use strict";
(function () {
  let figures = {};
  const status = document.getElementById("status");
  const drawn = new Map();
  const scenes = [];
  const MAX_SCENES = 8; // a browser keeps so many drawings in space alive
  const CONFIG = {
    displaylogo: false, displayModeBar: false, responsive: true, scrollZoom: false,
  };

  const hasWebGL = (function () {
    try {
      const canvas = document.createElement("canvas");
      return Boolean(canvas.getContext("webgl") || canvas.getContext("experimental-webgl"));
    } catch (error) { return false; }
  })();

  // -- colours: names of the style sheet become the colours of the theme

  function palette() {
    const style = getComputedStyle(document.documentElement);
    return (name) => style.getPropertyValue(name).trim();
  }
  function coloured(value, color) {
    if (typeof value === "string") {
      return value.startsWith("var(--") ? color(value.slice(4, -1)) : value;
    }
    if (Array.isArray(value)) { return value.map((item) => coloured(item, color)); }
    if (value && typeof value === "object") {
      const out = {};
      for (const key of Object.keys(value)) { out[key] = coloured(value[key], color); }
      return out;
    }
    return value;
  }
  function dressed(name) {
    const color = palette();
    const figure = coloured(figures[name], color);
    const layout = figure.layout;
    const narrow = window.innerWidth < 600;
    if ("paper" in document.documentElement.dataset) {
      layout.width = document.getElementById(name).clientWidth;
      layout.height = Math.min(layout.height, Math.max(170, 0.6 * layout.width), 240);
    }
    layout.paper_bgcolor = "rgba(0,0,0,0)";
    layout.plot_bgcolor = "rgba(0,0,0,0)";
    layout.font = { color: color("--ink"), size: narrow ? 11 : 12, family: "system-ui, Segoe UI, Roboto, Arial, sans-serif" };
    layout.hoverlabel = { bgcolor: color("--card"), bordercolor: color("--line"), font: { color: color("--ink") } };
    const axes = [layout.xaxis, layout.yaxis];
    if (layout.scene) {
      axes.push(layout.scene.xaxis, layout.scene.yaxis, layout.scene.zaxis);
      layout.scene.bgcolor = "rgba(0,0,0,0)";
      const away = Math.max(1, 390 / (document.getElementById(name).clientWidth || 390));
      const eye = layout.scene.camera.eye;
      layout.scene.camera.eye = { x: away * eye.x, y: away * eye.y, z: away * eye.z };
    }
    for (const axis of axes) {
      if (!axis) { continue; }
      axis.gridcolor = color("--grid");
      axis.linecolor = color("--muted");
      axis.zerolinecolor = color("--muted");
      axis.tickfont = { size: 11 };
      if (layout.scene) { axis.showbackground = false; axis.zerolinecolor = color("--grid"); }
      if (axis.title) { axis.title.font = { size: 12 }; }
    }
    return figure;
  }
  // without WebGL a surface becomes a map seen from above
  function flat(figure) {
    const top = figure.data.find((trace) => trace.type === "surface");
    const path = figure.data.find((trace) => trace.type === "scatter3d");
    const scene = figure.layout.scene;
    const layout = { height: figure.layout.height, font: figure.layout.font, margin: { l: 52, r: 14, t: 14, b: 44 },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", xaxis: scene.xaxis, yaxis: scene.yaxis };
    const data = [];
    if (top) {
      data.push({ type: "heatmap", x: top.x, y: top.y, z: top.z, colorscale: "Cividis", colorbar: { title: { text: figure.layout.annotations[0].text.replace("upright: ", "") } } });
    } else if (path) {
      data.push({ type: "scatter", mode: "lines", x: path.x, y: path.z, line: path.line });
      layout.yaxis = { ...scene.zaxis, title: { text: figure.layout.annotations[0].text.replace("upright: ", "") } };
    }
    return { data, layout };
  }

  // -- drawing: when a figure comes near the screen, and the other plane ones while nothing else is to be done

  // plotly and the figures are packed (deflate, 13 bits in two of 91 signs: ASCII from "!" without quote, "<" and
  // backslash); the page reads, sorts and scrolls before they are looked at
  async function unpacked(id) {
    const place = document.getElementById(id);
    const text = place.textContent, size = Number(place.dataset.size);
    const values = new Uint8Array(128), bytes = new Uint8Array(size);
    for (let code = 33, k = 0; code < 127; code++) { if (code !== 39 && code !== 60 && code !== 92) { values[code] = k++; } }
    for (let i = 0, at = 0, bits = 0, held = 0; at < size; i += 2) {
      held = (held << 13) | (91 * values[text.charCodeAt(i)] + values[text.charCodeAt(i + 1)]);
      for (bits += 13; bits >= 8 && at < size; at++) { bits -= 8; bytes[at] = held >> bits; }
      held &= (1 << bits) - 1;
    }
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).text();
  }
  async function unpack() {
    if (!("DecompressionStream" in window)) { status.textContent = "This browser is too old to draw the figures."; return; }
    const script = document.createElement("script");
    script.textContent = await unpacked("plotly");
    document.head.append(script);
    figures = JSON.parse(await unpacked("figures"));
    for (const place of document.querySelectorAll("[data-numbers]")) {
      place.insertAdjacentHTML("beforeend", figures[place.dataset.numbers].numbers);
    }
    begin();
  }
  function draw(name) {
    const place = document.getElementById(name);
    if (!place || !figures[name] || drawn.has(name)) { return; }
    let figure = dressed(name);
    const space = Boolean(figure.layout.scene);
    if (space && !hasWebGL) { figure = flat(figure); }
    drawn.set(name, place);
    Plotly.newPlot(place, figure.data, figure.layout, CONFIG);
    if (space && hasWebGL) {
      scenes.push(name);
      while (scenes.length > MAX_SCENES) { undraw(scenes[0]); }
    }
  }
  function undraw(name) {
    const place = drawn.get(name);
    scenes.splice(scenes.indexOf(name), 1);
    if (place) { Plotly.purge(place); place.replaceChildren(); drawn.delete(name); }
  }
  function redraw() {
    for (const [name, place] of drawn) {
      const figure = dressed(name);
      if (figure.layout.scene && !hasWebGL) { const f = flat(figure); Plotly.react(place, f.data, f.layout, CONFIG); continue; }
      if (figure.layout.scene) { figure.layout.scene.camera = camera(place); }
      Plotly.react(place, figure.data, figure.layout, CONFIG);
    }
  }
  const places = Array.from(document.querySelectorAll(".plot"));
  function begin() {
    if (!("IntersectionObserver" in window)) { places.forEach((place) => draw(place.id)); return; }
    const watch = new IntersectionObserver((entries) => {
      for (const entry of entries) { if (entry.isIntersecting) { draw(entry.target.id); } }
    }, { rootMargin: "400px 0px" });
    places.forEach((place) => watch.observe(place));
    later();
  }
  function idle() {
    const next = places.find((p) => !drawn.has(p.id) && !figures[p.id].layout.scene);
    if (!next) { document.documentElement.dataset.drawn = "all"; return; }
    draw(next.id);
    later();
  }
  function later() {
    if ("requestIdleCallback" in window) { requestIdleCallback(idle, { timeout: 2000 }); } else { setTimeout(idle, 100); }
  }
  window.addEventListener("load", () => requestAnimationFrame(() => setTimeout(unpack, 0)));

  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  if (scheme.addEventListener) { scheme.addEventListener("change", redraw); }
  window.addEventListener("beforeprint", () => {
    Object.assign(document.documentElement.dataset, { theme: "light", paper: "" }); // as wide as paper, to be measured
    places.forEach((place) => { if (!figures[place.id] || !figures[place.id].layout.scene || scenes.length < MAX_SCENES) { draw(place.id); } });
    redraw();
  });
  window.addEventListener("afterprint", () => {
    for (const name of ["theme", "paper"]) { delete document.documentElement.dataset[name]; }
    redraw();
  });

  // -- numbers in sentences as printed ones: 1.5e+09 is 1.5×10⁹

  for (const place of document.querySelectorAll(".sentence, .lead, .about, .frame p, .care li, .facts dd")) {
    if (place.children.length) { continue; }
    const power = (_, digit, sign, size) => digit + "×10<sup>" + (sign === "-" ? "−" : "") + size + "</sup>";
    place.innerHTML = place.innerHTML.replace(/(\d)e([+-])0?(\d+)/g, power);
  }

  // -- turning a surface with keys and buttons

  function camera(place) {
    const scene = place._fullLayout && place._fullLayout.scene;
    const live = scene && scene._scene && scene._scene.getCamera ? scene._scene.getCamera() : null;
    return live || (place.layout && place.layout.scene && place.layout.scene.camera) || figures[place.id].layout.scene.camera;
  }
  function turn(place, way) {
    if (!place || !hasWebGL || !figures[place.id]) { return; }
    draw(place.id);
    if (way === "home") { Plotly.relayout(place, { "scene.camera": dressed(place.id).layout.scene.camera }); return; }
    const now = JSON.parse(JSON.stringify(camera(place)));
    const eye = now.eye;
    const around = { left: -0.2, right: 0.2 }[way] || 0;
    const over = { up: 0.15, down: -0.15 }[way] || 0;
    const flatRadius = Math.hypot(eye.x, eye.y);
    const radius = Math.hypot(flatRadius, eye.z);
    const angle = Math.atan2(eye.y, eye.x) + around;
    const height = Math.min(1.5, Math.max(-1.5, Math.atan2(eye.z, flatRadius) + over));
    now.eye = { x: radius * Math.cos(height) * Math.cos(angle), y: radius * Math.cos(height) * Math.sin(angle), z: radius * Math.sin(height) };
    Plotly.relayout(place, { "scene.camera": now });
  }
  const KEYS = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", Home: "home" };
  document.addEventListener("keydown", (event) => {
    const place = event.target.closest && event.target.closest(".turns");
    if (place && event.target === place && KEYS[event.key]) { event.preventDefault(); turn(place, KEYS[event.key]); }
  });
  document.addEventListener("click", (event) => {
    const save = event.target.closest("[data-save]");
    if (save) {
      const place = document.getElementById(save.dataset.save);
      draw(place.id);
      if (drawn.has(place.id)) Plotly.downloadImage(place, { format: "png", scale: 2, width: place.clientWidth, height: place.clientHeight, filename: save.dataset.name });
      return;
    }
    const button = event.target.closest("[data-turn]");
    if (button) { turn(document.getElementById(button.dataset.for), button.dataset.turn); }
  });

  // -- tables: sort and copy

  function key(cell) {
    const text = cell.dataset.v ?? cell.textContent.trim();
    const value = text === "" ? NaN : Number(text);
    return { text, value };
  }
  function sort(button) {
    const head = button.closest("th");
    const table = head.closest("table");
    const column = Array.from(head.parentNode.children).indexOf(head);
    const rising = head.getAttribute("aria-sort") !== "ascending";
    const rows = Array.from(table.tBodies[0].rows);
    const keys = new Map(rows.map((row) => [row, key(row.cells[column])]));
    const numeric = head.classList.contains("number");
    rows.sort((a, b) => {
      const p = keys.get(a), q = keys.get(b);
      if (numeric) {
        if (Number.isNaN(p.value) || Number.isNaN(q.value)) { return Number(Number.isNaN(p.value)) - Number(Number.isNaN(q.value)); }
        return rising ? p.value - q.value : q.value - p.value;
      }
      const order = p.text.localeCompare(q.text, undefined, { numeric: true });
      return rising ? order : -order;
    });
    table.tBodies[0].append(...rows);
    for (const other of head.parentNode.children) { other.setAttribute("aria-sort", "none"); }
    head.setAttribute("aria-sort", rising ? "ascending" : "descending");
    status.textContent = "Sorted by " + button.textContent + ", " + (rising ? "rising" : "falling") + ".";
  }
  function copy(button) {
    const table = button.closest(".table").querySelector("table");
    const lines = Array.from(table.rows).map((row) => Array.from(row.cells).map((cell) =>
      cell.dataset.v || cell.textContent.trim()).join("\t"));
    const text = lines.join("\n");
    const done = () => { status.textContent = "Table copied."; relabel(button, "Copied"); };
    const failed = () => { if (old(text)) { done(); } else { status.textContent = "Copying is not allowed here."; relabel(button, "Not allowed"); } };
    if (navigator.clipboard && navigator.clipboard.writeText) { navigator.clipboard.writeText(text).then(done, failed); } else { failed(); }
  }
  function relabel(button, word) {
    const first = button.firstChild;
    const before = first.data;
    first.data = word;
    setTimeout(() => { first.data = "Copy"; }, 1500);
    return before;
  }
  function old(text) {
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    let ok = false;
    try { ok = document.execCommand("copy"); } catch (error) { ok = false; }
    area.remove();
    return ok;
  }
  document.addEventListener("click", (event) => {
    const button = event.target.closest(".sort, [data-copy]");
    if (!button) { return; }
    if (button.classList.contains("sort")) { sort(button); } else { copy(button); }
  });
})();
