"use strict";
// Draws the charts of the page. Their data are in elements <script type="application/json" class="chart-data">.
(() => {
  const GAP = 65535, LEVELS = 65534;
  const NARROW = 2; // px: a gap is shown where it is wider, for narrow ones, as of each turn of a scan, hide what is between
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

  function values(line, logarithmic) {
    const bytes = Uint8Array.from(atob(line.data), (c) => c.charCodeAt(0));
    const step = (line.high - line.low) / LEVELS, found = new Array(bytes.length / 2);
    for (let i = 0; i < found.length; i++) {
      const level = bytes[2 * i] + 256 * bytes[2 * i + 1];
      const value = line.low + step * level;
      found[i] = level === GAP ? null : logarithmic ? 10 ** value : value;
    }
    return found;
  }

  const rounded = (value) => (value == null ? "-" : Number(value.toPrecision(5)).toString());

  // Of a logarithmic axis: decades alone, but within one of them all that there are.
  const labelled = (u, ticks) => ticks.map((v) => (u.scales.x.max < 12 * u.scales.x.min || Math.log10(v) % 1 === 0 ? v : null));

  function options(chart, panel, last, x, width, zoomed) {
    const axis = { stroke: () => colour("text"), grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("muted"), width: 1, size: 4 }, font: "12px system-ui, sans-serif" };
    return {
      width, height: last ? 210 : 180, padding: [8, 22, 0, 0],
      cursor: { sync: { key: "run", setSeries: false }, drag: { x: true, y: false }, points: { size: 6 } },
      scales: { x: { time: false, distr: chart.places ? 3 : 1, range: (u, low, high) => [low, high] },
        y: { distr: panel.logarithmic ? 3 : 1 } },
      legend: { live: true, markers: { stroke: (u, i) => (i ? `var(--${panel.lines[i - 1].role})` : "") } }, // follows light and dark
      axes: [{ ...axis, label: last ? chart.label : undefined, labelSize: 20, size: last ? 34 : 20, labelFont: axis.font,
        values: last ? undefined : (u, ticks) => ticks.map(() => ""), filter: chart.places ? labelled : undefined },
        { ...axis, size: 58, label: panel.label, labelSize: 20, labelFont: axis.font }],
      series: [{ label: chart.label, value: (u, at) => rounded(at) },
        ...panel.lines.map((line) => ({ label: line.name, stroke: () => colour(line.role), width: line.points ? 0 : line.role === "desired" ? 3 : 1.2,
          gaps: (u, i, from, to, found) => found.filter(([begin, end]) => end - begin > NARROW * devicePixelRatio),
          points: { show: Boolean(line.points), size: 4, fill: () => colour(line.role) }, value: (u, value) => rounded(value) }))],
      hooks: { setScale: [(u, key) => { if (key === "x") zoomed(u.scales.x.min, u.scales.x.max); }] },
    };
  }

  function draw(holder) {
    const chart = JSON.parse(holder.querySelector(".chart-data").textContent);
    const x = Float64Array.from(chart.places || { length: chart.samples }, (at, i) => chart.places ? at : chart.start + i * chart.step);
    // Parts are kept as the axis shows them: of a logarithmic one as logarithms.
    const [shownAs, place] = chart.places ? [Math.log, Math.exp] : [(v) => v, (v) => v];
    const whole = [x[0], x[x.length - 1]].map(shownAs), drawn = [];
    const shortest = chart.places ? 0.05 : 8 * chart.step;
    let shown = whole, busy = false;

    function show(from, to) {
      if (busy) return;
      let width = Math.min(Math.max(to - from, shortest), whole[1] - whole[0]);
      const begin = Math.min(Math.max(from, whole[0]), whole[1] - width);
      shown = [begin, begin + width];
      busy = true;
      const [low, high] = shown.map(place);
      for (const u of drawn) u.setScale("x", { min: low, max: high });
      busy = false;
      holder.dataset.shown = rounded(low) + " " + rounded(high);
      const all = shown[0] === whole[0] && shown[1] === whole[1];
      try { history.replaceState(null, "", all ? location.pathname + location.search : "#from=" + rounded(low) + "&to=" + rounded(high)); }
      catch { /* a page that may not change its address */ }
    }
    const zoom = (factor, at = (shown[0] + shown[1]) / 2) => show(at - (at - shown[0]) * factor, at + (shown[1] - at) * factor);
    const pan = (share) => show(shown[0] + share * (shown[1] - shown[0]), shown[1] + share * (shown[1] - shown[0]));
    const all = () => show(whole[0], whole[1]);

    const panels = holder.querySelector(".chart-panels");
    const width = () => Math.max(240, panels.clientWidth);
    holder.hidden = false;
    chart.panels.forEach((panel, i) => {
      const lines = panel.lines.map((line) => values(line, panel.logarithmic));
      const made = options(chart, panel, i === chart.panels.length - 1, x, width(), (from, to) => {
        const part = [from, to].map(shownAs);
        if (!busy && from != null && (part[0] !== shown[0] || part[1] !== shown[1])) queueMicrotask(() => show(...part));
      });
      drawn.push(new uPlot(made, [x, ...lines], panels));
    });

    const does = { nearer: () => zoom(0.5), further: () => zoom(2), earlier: () => pan(-0.5), later: () => pan(0.5), all };
    for (const button of holder.querySelectorAll("button[data-does]")) button.addEventListener("click", does[button.dataset.does]);
    const keys = { ArrowLeft: does.earlier, ArrowRight: does.later, "+": does.nearer, "=": does.nearer, "-": does.further, Home: all };
    panels.addEventListener("keydown", (event) => { if (keys[event.key]) { event.preventDefault(); keys[event.key](); } });
    panels.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      const box = drawn[0].over.getBoundingClientRect();
      zoom(event.deltaY > 0 ? 1.25 : 0.8, shownAs(drawn[0].posToVal(event.clientX - box.left, "x")));
    }, { passive: false });
    touch(panels, drawn, () => shown, show);
    new ResizeObserver(() => { for (const u of drawn) u.setSize({ width: width(), height: u.height }); }).observe(panels);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const u of drawn) u.redraw(false); });
    const asked = new URLSearchParams(location.hash.slice(1));
    const part = [asked.get("from"), asked.get("to")].map((text) => (text ? Number(text) : NaN)); // an address may be mangled
    if (part.every(Number.isFinite)) show(...part.map(shownAs));
    else holder.dataset.shown = shown.map(place).map(rounded).join(" ");
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
