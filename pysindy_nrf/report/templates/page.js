"use strict";
(function () {
  let figures = {};
  const status = document.getElementById("status");
  const drawn = new Map();
  const scenes = [];
  const MAX_SCENES = 8; // a browser keeps so many drawings in space alive
  const CLEAR = "rgba(0,0,0,0)";
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
  function themed(name) {
    const color = palette();
    const figure = coloured(figures[name], color);
    const layout = figure.layout;
    if ("paper" in document.documentElement.dataset) {
      layout.width = document.getElementById(name).clientWidth;
      const isOnePage = "onepage" in document.documentElement.dataset;
      const highest = layout.scene ? 420 : isOnePage ? 140 : 240;
      if (isOnePage && layout.yaxis2) { layout.height = 215; }
      if (!layout.yaxis2) {
        layout.height = Math.min(layout.height, Math.max(140, 0.6 * layout.width), highest);
      }
    }
    layout.paper_bgcolor = CLEAR;
    layout.plot_bgcolor = CLEAR;
    layout.font = {
      color: color("--ink"),
      size: smallText() ? 8 : window.innerWidth < 600 ? 11 : 12,
      family: "system-ui, Segoe UI, Roboto, Arial, sans-serif",
    };
    layout.hoverlabel = {
      bgcolor: color("--card"),
      bordercolor: color("--line"),
      font: { color: color("--ink") },
    };
    if (layout.scene) { stepBack(layout.scene, document.getElementById(name).clientWidth); }
    const scene = layout.scene || {};
    const ofPlane = Object.keys(layout).filter((key) => /^[xy]axis/.test(key));
    const axes = ofPlane.map((key) => layout[key]);
    for (const axis of [...axes, scene.xaxis, scene.yaxis, scene.zaxis]) {
      if (axis) { themeAxis(axis, color, Boolean(layout.scene)); }
    }
    return figure;
  }
  function smallText() { return "onepage" in document.documentElement.dataset; }
  // a surface on a narrow screen is seen from farther away
  function stepBack(scene, width) {
    const away = Math.max(1, 390 / (width || 390));
    const eye = scene.camera.eye;
    scene.camera.eye = { x: away * eye.x, y: away * eye.y, z: away * eye.z };
    scene.bgcolor = CLEAR;
  }
  function themeAxis(axis, color, inSpace) {
    axis.gridcolor = color("--grid");
    axis.linecolor = color("--muted");
    axis.zerolinecolor = color(inSpace ? "--grid" : "--muted");
    axis.tickfont = { size: smallText() ? 8 : 11 };
    if (inSpace) { axis.showbackground = false; }
    if (axis.title) { axis.title.font = { size: smallText() ? 8 : 12 }; }
  }
  // without WebGL a surface becomes a map seen from above
  function flat(figure) {
    const top = figure.data.find((trace) => trace.type === "surface");
    const path = figure.data.find((trace) => trace.type === "scatter3d");
    const scene = figure.layout.scene;
    const upright = { text: figure.layout.annotations[0].text.replace("upright: ", "") };
    const layout = {
      height: figure.layout.height,
      font: figure.layout.font,
      margin: { l: 52, r: 14, t: 14, b: 44 },
      paper_bgcolor: CLEAR,
      plot_bgcolor: CLEAR,
      xaxis: scene.xaxis,
      yaxis: scene.yaxis,
    };
    const data = [];
    if (top) {
      const colorbar = { title: upright };
      data.push({ type: "heatmap", x: top.x, y: top.y, z: top.z, colorscale: "Cividis", colorbar });
    } else if (path) {
      data.push({ type: "scatter", mode: "lines", x: path.x, y: path.z, line: path.line });
      layout.yaxis = { ...scene.zaxis, title: upright };
    }
    return { data, layout };
  }

  // -- unpacking: plotly and the figures are packed (deflate, 13 bits in two of 91 signs: ASCII
  // from "!" without quote, "<" and backslash), and looked at once the page reads and scrolls

  function valuesOfSigns() {
    const values = new Uint8Array(128);
    let next = 0;
    for (let code = 33; code < 127; code++) {
      const leftOut = code === 39 || code === 60 || code === 92;
      if (!leftOut) { values[code] = next++; }
    }
    return values;
  }
  function bytesOf(text, size) {
    const values = valuesOfSigns();
    const bytes = new Uint8Array(size);
    let written = 0;
    let held = 0; // bits that do not fill a byte yet
    let bits = 0; // how many they are
    for (let i = 0; written < size; i += 2) {
      const pair = 91 * values[text.charCodeAt(i)] + values[text.charCodeAt(i + 1)];
      held = (held << 13) | pair;
      bits += 13;
      while (bits >= 8 && written < size) {
        bits -= 8;
        bytes[written] = held >> bits;
        written += 1;
      }
      held &= (1 << bits) - 1;
    }
    return bytes;
  }
  async function unpacked(id) {
    const place = document.getElementById(id);
    const bytes = bytesOf(place.textContent, Number(place.dataset.size));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).text();
  }
  async function unpack() {
    if (!("DecompressionStream" in window)) {
      status.textContent = "This browser is too old to draw the figures.";
      return;
    }
    const script = document.createElement("script");
    script.textContent = await unpacked("plotly");
    document.head.append(script);
    figures = JSON.parse(await unpacked("figures"));
    for (const place of document.querySelectorAll("[data-numbers]")) {
      place.insertAdjacentHTML("beforeend", figures[place.dataset.numbers].numbers);
    }
    begin();
  }

  // -- drawing: when a figure comes near the screen, and other plane ones while the browser is idle

  function inSpace(name) { return Boolean(figures[name].layout.scene); }
  function drawing(name) {
    const figure = themed(name);
    return inSpace(name) && !hasWebGL ? flat(figure) : figure;
  }
  function draw(name) {
    const place = document.getElementById(name);
    if (!place || !figures[name] || drawn.has(name)) { return; }
    const figure = drawing(name);
    drawn.set(name, place);
    Plotly.newPlot(place, figure.data, figure.layout, CONFIG);
    if (inSpace(name) && hasWebGL) {
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
      const figure = drawing(name);
      if (figure.layout.scene) { figure.layout.scene.camera = camera(place); }
      Plotly.react(place, figure.data, figure.layout, CONFIG);
    }
  }
  const places = Array.from(document.querySelectorAll(".plot"));
  function begin() {
    if (!("IntersectionObserver" in window)) {
      places.forEach((place) => draw(place.id));
      return;
    }
    const watch = new IntersectionObserver((entries) => {
      for (const entry of entries) { if (entry.isIntersecting) { draw(entry.target.id); } }
    }, { rootMargin: "400px 0px" });
    places.forEach((place) => watch.observe(place));
    later();
  }
  function idle() {
    // a place in a closed part of the page has no width yet; it is drawn when it opens
    const waits = (place) => !drawn.has(place.id) && !inSpace(place.id) && place.clientWidth > 0;
    const next = places.find(waits);
    if (!next) {
      document.documentElement.dataset.drawn = "all";
      return;
    }
    draw(next.id);
    later();
  }
  function later() {
    if ("requestIdleCallback" in window) {
      requestIdleCallback(idle, { timeout: 2000 });
    } else {
      setTimeout(idle, 100);
    }
  }
  window.addEventListener("load", () => requestAnimationFrame(() => setTimeout(unpack, 0)));

  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  if (scheme.addEventListener) { scheme.addEventListener("change", redraw); }
  window.addEventListener("beforeprint", () => {
    // as wide as paper, to be measured
    Object.assign(document.documentElement.dataset, { theme: "light", paper: "" });
    for (const { id } of places) {
      const isOpen = document.getElementById(id).clientWidth > 0;
      if (isOpen && (!figures[id] || !inSpace(id) || scenes.length < MAX_SCENES)) { draw(id); }
    }
    redraw();
  });
  window.addEventListener("afterprint", () => {
    for (const name of ["theme", "paper"]) { delete document.documentElement.dataset[name]; }
    redraw();
  });

  // the first screen, the first figures and the numbers, as one page of paper
  document.addEventListener("click", (event) => {
    if (!event.target.closest("[data-print]")) { return; }
    document.documentElement.dataset.onepage = "";
    window.addEventListener("afterprint", () => {
      delete document.documentElement.dataset.onepage;
    }, { once: true });
    window.print();
  });

  // -- modes move unless the reader stops them or prefers rest; on paper they never do

  const rest = window.matchMedia("(prefers-reduced-motion: reduce)");
  function move(button, moves) {
    button.closest(".modes").classList.toggle("moving", moves);
    button.textContent = moves ? "Stop" : "Move";
    button.setAttribute("aria-pressed", String(moves));
  }
  for (const button of document.querySelectorAll("[data-move]")) {
    move(button, !rest.matches);
    button.addEventListener("click", () => {
      move(button, !button.closest(".modes").classList.contains("moving"));
    });
  }

  // -- numbers in sentences as printed ones: 1.5e+09 is 1.5×10⁹

  const PROSE = ".sentence, .lead, .about, .frame p, .care li, .facts dd";
  for (const place of document.querySelectorAll(PROSE)) {
    if (place.children.length) { continue; }
    const power = (_, digit, sign, size) => {
      const minus = sign === "-" ? "−" : "";
      return `${digit}×10<sup>${minus}${size}</sup>`;
    };
    place.innerHTML = place.innerHTML.replace(/(\d)e([+-])0?(\d+)/g, power);
  }

  // -- turning a surface with keys and buttons

  function camera(place) {
    const live = place._fullLayout?.scene?._scene?.getCamera?.();
    return live || place.layout?.scene?.camera || figures[place.id].layout.scene.camera;
  }
  function turn(place, way) {
    if (!place || !hasWebGL || !figures[place.id]) { return; }
    draw(place.id);
    if (way === "home") {
      Plotly.relayout(place, { "scene.camera": themed(place.id).layout.scene.camera });
      return;
    }
    const now = JSON.parse(JSON.stringify(camera(place)));
    const eye = now.eye;
    const around = { left: -0.2, right: 0.2 }[way] || 0;
    const over = { up: 0.15, down: -0.15 }[way] || 0;
    const flatRadius = Math.hypot(eye.x, eye.y);
    const radius = Math.hypot(flatRadius, eye.z);
    const angle = Math.atan2(eye.y, eye.x) + around;
    const height = Math.min(1.5, Math.max(-1.5, Math.atan2(eye.z, flatRadius) + over));
    now.eye = {
      x: radius * Math.cos(height) * Math.cos(angle),
      y: radius * Math.cos(height) * Math.sin(angle),
      z: radius * Math.sin(height),
    };
    Plotly.relayout(place, { "scene.camera": now });
  }
  const KEYS = {
    ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", Home: "home",
  };
  document.addEventListener("keydown", (event) => {
    const place = event.target.closest?.(".turns");
    if (!place || event.target !== place || !KEYS[event.key]) { return; }
    event.preventDefault();
    turn(place, KEYS[event.key]);
  });
  function save(button) {
    const place = document.getElementById(button.dataset.save);
    draw(place.id);
    if (!drawn.has(place.id)) { return; }
    Plotly.downloadImage(place, {
      format: "png",
      scale: 2,
      width: place.clientWidth,
      height: place.clientHeight,
      filename: button.dataset.name,
    });
  }
  document.addEventListener("click", (event) => {
    const button = event.target.closest("[data-save], [data-turn]");
    if (!button) { return; }
    if ("save" in button.dataset) {
      save(button);
    } else {
      turn(document.getElementById(button.dataset.for), button.dataset.turn);
    }
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
      const p = keys.get(a);
      const q = keys.get(b);
      if (!numeric) {
        const order = p.text.localeCompare(q.text, undefined, { numeric: true });
        return rising ? order : -order;
      }
      const missing = [p.value, q.value].map((value) => Number(Number.isNaN(value)));
      if (missing[0] || missing[1]) { return missing[0] - missing[1]; } // to the end
      return rising ? p.value - q.value : q.value - p.value;
    });
    table.tBodies[0].append(...rows);
    for (const other of head.parentNode.children) { other.setAttribute("aria-sort", "none"); }
    head.setAttribute("aria-sort", rising ? "ascending" : "descending");
    status.textContent = `Sorted by ${button.textContent}, ${rising ? "rising" : "falling"}.`;
  }
  function copy(button) {
    const text = asText(button.closest(".table").querySelector("table"));
    const done = () => {
      status.textContent = "Table copied.";
      relabel(button, "Copied");
    };
    const refused = () => {
      if (copiedBySelection(text)) { done(); return; }
      status.textContent = "Copying is not allowed here.";
      relabel(button, "Not allowed");
    };
    if (navigator.clipboard && navigator.clipboard.writeText) {
      navigator.clipboard.writeText(text).then(done, refused);
    } else {
      refused();
    }
  }
  function asText(table) {
    const words = (cell) => cell.dataset.v || cell.textContent.trim();
    const lines = Array.from(table.rows, (row) => Array.from(row.cells, words).join("\t"));
    return lines.join("\n");
  }
  function relabel(button, word) {
    const label = button.firstChild;
    label.data = word;
    setTimeout(() => { label.data = "Copy"; }, 1500);
  }
  // how browsers copied before they had a clipboard, and still do in pages opened from a file
  function copiedBySelection(text) {
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    let copied = false;
    try { copied = document.execCommand("copy"); } catch (error) { copied = false; }
    area.remove();
    return copied;
  }
  document.addEventListener("click", (event) => {
    const button = event.target.closest(".sort, [data-copy]");
    if (!button) { return; }
    if (button.classList.contains("sort")) { sort(button); } else { copy(button); }
  });
})();
