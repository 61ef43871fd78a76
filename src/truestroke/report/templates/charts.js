"use strict";
// Draws the charts of the page. Their data are in elements <script type="application/json" class="chart-data">.
(() => {
  const GAP = 65535, LEVELS = 65534;
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

  function values(line) {
    const bytes = Uint8Array.from(atob(line.data), (c) => c.charCodeAt(0));
    const step = (line.high - line.low) / LEVELS, found = new Array(bytes.length / 2);
    for (let i = 0; i < found.length; i++) {
      const level = bytes[2 * i] + 256 * bytes[2 * i + 1];
      found[i] = level === GAP ? null : line.low + step * level;
    }
    return found;
  }

  const rounded = (value) => (value == null ? "-" : Number(value.toPrecision(5)).toString());

  function options(chart, panel, last, x, width, zoomed) {
    const axis = { stroke: () => colour("text"), grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("muted"), width: 1, size: 4 }, font: "12px system-ui, sans-serif" };
    return {
      width, height: last ? 210 : 180, padding: [8, 8, 0, 0],
      cursor: { sync: { key: "run", setSeries: false }, drag: { x: true, y: false }, points: { size: 6 } },
      scales: { x: { time: false } },
      legend: { live: true },
      axes: [{ ...axis, label: last ? chart.label : undefined, labelSize: 20, size: last ? 34 : 20, labelFont: axis.font,
        values: last ? undefined : (u, ticks) => ticks.map(() => "") },
        { ...axis, size: 58, label: panel.label, labelSize: 20, labelFont: axis.font }],
      series: [{ label: chart.label, value: (u, at) => rounded(at) },
        ...panel.lines.map((line) => ({ label: line.name, stroke: () => colour(line.role), width: line.role === "desired" ? 3 : 1.2,
          points: { show: false }, value: (u, value) => rounded(value) }))],
      hooks: { setScale: [(u, key) => { if (key === "x") zoomed(u.scales.x.min, u.scales.x.max); }] },
    };
  }

  function draw(holder) {
    const chart = JSON.parse(holder.querySelector(".chart-data").textContent);
    const x = Float64Array.from({ length: chart.samples }, (_, i) => chart.start + i * chart.step);
    const whole = [x[0], x[x.length - 1]], shortest = 8 * chart.step, drawn = [];
    let shown = whole, busy = false;

    function show(from, to) {
      if (busy) return;
      let width = Math.min(Math.max(to - from, shortest), whole[1] - whole[0]);
      const begin = Math.min(Math.max(from, whole[0]), whole[1] - width);
      shown = [begin, begin + width];
      busy = true;
      for (const u of drawn) u.setScale("x", { min: shown[0], max: shown[1] });
      busy = false;
      holder.dataset.shown = shown.map(rounded).join(" ");
      const all = shown[0] === whole[0] && shown[1] === whole[1];
      try { history.replaceState(null, "", all ? location.pathname + location.search : "#from=" + rounded(shown[0]) + "&to=" + rounded(shown[1])); }
      catch { /* a page that may not change its address */ }
    }
    const zoom = (factor, at = (shown[0] + shown[1]) / 2) => show(at - (at - shown[0]) * factor, at + (shown[1] - at) * factor);
    const pan = (share) => show(shown[0] + share * (shown[1] - shown[0]), shown[1] + share * (shown[1] - shown[0]));
    const all = () => show(whole[0], whole[1]);

    const place = holder.querySelector(".chart-panels");
    const width = () => Math.max(240, place.clientWidth);
    holder.hidden = false;
    chart.panels.forEach((panel, i) => {
      const lines = panel.lines.map(values);
      const made = options(chart, panel, i === chart.panels.length - 1, x, width(), (from, to) => {
        if (!busy && from != null && (from !== shown[0] || to !== shown[1])) queueMicrotask(() => show(from, to));
      });
      drawn.push(new uPlot(made, [x, ...lines], place));
    });

    const does = { nearer: () => zoom(0.5), further: () => zoom(2), earlier: () => pan(-0.5), later: () => pan(0.5), all };
    for (const button of holder.querySelectorAll("button[data-does]")) button.addEventListener("click", does[button.dataset.does]);
    const keys = { ArrowLeft: does.earlier, ArrowRight: does.later, "+": does.nearer, "=": does.nearer, "-": does.further, Home: all };
    place.addEventListener("keydown", (event) => { if (keys[event.key]) { event.preventDefault(); keys[event.key](); } });
    place.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      const box = drawn[0].over.getBoundingClientRect();
      zoom(event.deltaY > 0 ? 1.25 : 0.8, drawn[0].posToVal(event.clientX - box.left, "x"));
    }, { passive: false });
    touch(place, drawn, () => shown, show);
    new ResizeObserver(() => { for (const u of drawn) u.setSize({ width: width(), height: u.height }); }).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const u of drawn) u.redraw(false); });
    const asked = new URLSearchParams(location.hash.slice(1));
    const part = [asked.get("from"), asked.get("to")].map((text) => (text ? Number(text) : NaN)); // an address may be mangled
    if (part.every(Number.isFinite)) show(...part);
    else holder.dataset.shown = shown.map(rounded).join(" ");
  }

  // One finger moves the part that is shown, two fingers zoom.
  function touch(place, drawn, shown, show) {
    let begin = null;
    const at = (event) => Array.from(event.touches, (t) => t.clientX - drawn[0].over.getBoundingClientRect().left);
    place.addEventListener("touchstart", (event) => { begin = { x: at(event), shown: shown() }; }, { passive: true });
    place.addEventListener("touchmove", (event) => {
      const now = at(event), wide = drawn[0].over.clientWidth;
      if (!begin || now.length !== begin.x.length) return;
      const [from, to] = begin.shown, of = (x) => from + (x / wide) * (to - from);
      if (now.length === 1) { const moved = of(begin.x[0]) - of(now[0]); show(from + moved, to + moved); return; }
      const spread = Math.abs(begin.x[1] - begin.x[0]) / Math.max(8, Math.abs(now[1] - now[0])), middle = of((begin.x[0] + begin.x[1]) / 2);
      show(middle - (middle - from) * spread, middle + (to - middle) * spread);
    }, { passive: true });
  }

  for (const holder of document.querySelectorAll(".chart")) draw(holder);
})();
