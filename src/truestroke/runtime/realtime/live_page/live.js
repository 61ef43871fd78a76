"use strict";
// The live page: reads a stream of frames, one JSON object a line, and asks for what its buttons say.
(() => {
  const token = location.hash.slice(1), by = (id) => document.getElementById(id), authorization = { Authorization: "Bearer " + token };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  let about = null, panels = [], held = false, last = 0, wound = -Infinity, wanted = null;

  function say(sentence) { by("complaint").textContent = sentence; by("complaint").hidden = !sentence; }

  async function ask(what) {
    try {
      const answer = await fetch("/do", { method: "POST", headers: { ...authorization, "Content-Type": "application/json" }, body: JSON.stringify(what) });
      say(answer.ok ? "" : (await answer.json()).error);
    } catch { say("The run does not answer."); }
  }

  function name(node, text) { if (node.textContent !== text) node.textContent = text; } // a screen reader says each change
  const element = (tag, text, of = {}) => Object.assign(document.createElement(tag), { textContent: text, ...of });

  function chart(place, label, lines, height, named = false) {
    const x = "time (s)";
    const axis = { stroke: () => colour("text"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("muted"), width: 1, size: 4 } };
    const width = () => Math.max(220, place.clientWidth);
    const plot = new uPlot({
      width: width(), height, padding: [8, 18, 0, 0], cursor: { drag: { x: false, y: false } }, scales: { x: { time: false } },
      legend: { show: named, live: false, markers: { stroke: (u, i) => (i ? `var(--${lines[i - 1][1]})` : "") } }, // follows light and dark
      axes: [{ ...axis, size: 34, label: x, labelSize: 18 }, { ...axis, size: 60, label, labelSize: 18 }],
      series: [{ label: x }, ...lines.map(([name, role, width_]) => ({ label: name, stroke: () => colour(role), width: width_, points: { show: false } }))],
    }, [[], ...lines.map(() => [])], place);
    plot.root.setAttribute("role", "img");
    plot.root.setAttribute("aria-label", label + " over " + x + ": " + lines.map(([named_]) => named_).join(", "));
    new ResizeObserver(() => plot.setSize({ width: width(), height })).observe(place);
    return plot;
  }

  function loop(place, of) { // measured over volts: a canvas, for its line turns back
    const canvas = element("canvas", "", { className: "loop-canvas" });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", of + ": measured displacement over voltage");
    place.append(canvas);
    return (x, y, [low, high], [bottom, top]) => {
      const scale = devicePixelRatio || 1, wide = Math.max(220, place.clientWidth), tall = Math.min(wide, 420), g = canvas.getContext("2d");
      canvas.width = wide * scale; canvas.height = tall * scale; canvas.style.width = wide + "px"; canvas.style.height = tall + "px";
      g.scale(scale, scale); g.font = "12px system-ui, sans-serif"; g.fillStyle = colour("text"); g.strokeStyle = colour("grid"); g.lineWidth = 1;
      const short = (v, from, to) => String(Number(v.toFixed(Math.max(0, 2 - Math.floor(Math.log10(to - from || 1)))))); // both ends differ
      const left = 62, foot = 36, px = (v) => left + (v - low) / (high - low || 1) * (wide - left - 8), py = (v) => tall - foot - (v - bottom) / (top - bottom || 1) * (tall - foot - 8);
      g.strokeRect(left, 8, wide - left - 8, tall - foot - 8);
      g.textAlign = "center"; g.fillText("voltage (V)", (left + wide) / 2, tall - 4); g.fillText(short(low, low, high), left, tall - 20); g.fillText(short(high, low, high), wide - 20, tall - 20);
      g.save(); g.translate(12, tall / 2); g.rotate(-Math.PI / 2); g.fillText("measured (µm)", 0, 0); g.restore();
      g.textAlign = "right"; g.fillText(short(top, bottom, top), left - 4, 18); g.fillText(short(bottom, bottom, top), left - 4, tall - foot);
      g.strokeStyle = colour("measured"); g.lineWidth = 1.2; g.beginPath();
      let pen = false;
      x.forEach((v, i) => { if (v == null || y[i] == null) { pen = false; return; } if (pen) g.lineTo(px(v), py(y[i])); else g.moveTo(px(v), py(y[i])); pen = true; });
      g.stroke();
    };
  }

  function prepare() {
    by("axes").replaceChildren();
    panels = about.axes.map((axis, channel) => {
      const section = element("section", ""), lines = element("div", "", { className: "lines" }), round = element("div", "", { className: "loop" });
      const flags = element("p", "", { className: "flags" });
      section.append(element("h2", about.axes.length > 1 ? "Axis " + axis.name : "Tracking"));
      if (axis.moved && about.control) section.append(setpoint(axis, channel));
      section.append(flags, lines, round);
      by("axes").append(section);
      return {
        flags, axis, goal: section.querySelector("form input"), loop: loop(round, axis.name),
        motion: chart(lines, "displacement (µm)", [["desired", "desired", 3], ["measured", "measured", 1.2]], 240, true),
        error: chart(lines, "error (nm)", [["error", "measured", 1]], 200),
        volts: chart(lines, "voltage (V)", [["voltage", "measured", 1.2], ["highest allowed", "limit", 1], ["lowest allowed", "limit", 1]], 200, true),
      };
    });
    for (const button of document.querySelectorAll(".control")) button.disabled = !about.control;
  }

  function setpoint(axis, channel) {
    const form = element("form", ""), field = element("input", "", { type: "number", step: "any", min: axis.reach[0], max: axis.reach[1], required: true });
    const fast = element("input", "", { type: "number", step: "any", min: axis.speed * 1e-4, max: axis.speed, value: axis.speed, required: true });
    const named = (text, input) => { const label = element("label", text + " "); label.append(input, " "); return label; };
    form.append(named("Set-point (µm)", field), named("speed (µm/s)", fast), element("button", "Go"));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      await ask({ do: "speed", axis: channel, um_per_s: Number(fast.value) });
      await ask({ do: "setpoint", axis: channel, um: Number(field.value) });
    });
    return form;
  }

  const PACES = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100], STEPS = 200, SETTLED = 500; // of the slider; ms after it was moved
  function tape(frame) { // of a replay: where it is and how fast
    by("tape").hidden = !frame.replay;
    if (!frame.replay) return;
    const time = by("time"), pace = by("pace"), whole = Math.floor(1e3 * (frame.time + frame.left) + 1e-6) / 1e3; // not beyond the end
    if (time.max !== String(whole)) Object.assign(time, { max: whole, step: whole / STEPS });
    if (performance.now() - wound > SETTLED) time.value = frame.time;
    const at = frame.time.toFixed(2) + " s of " + whole.toFixed(2) + " s";
    name(by("place"), at);
    time.setAttribute("aria-valuetext", at);
    if (!pace.options.length) for (const one of [...new Set([...PACES, frame.replay])].sort((a, b) => a - b)) pace.add(new Option(one + " ×", one));
    if (performance.now() - wound > SETTLED) pace.value = frame.replay;
  }

  async function wind() { // one request at a time, the newest place last
    wound = performance.now();
    if (wanted !== null) { wanted = Number(by("time").value); return; }
    for (wanted = Number(by("time").value); ;) {
      const now = wanted;
      await ask({ do: "seek", s: now });
      if (wanted === now) break;
    }
    wanted = null;
  }

  const refused = (kinds) => Object.entries(kinds).map(([words, n]) => n + " " + words).join(", ") || "none";
  const seconds = (s) => s.toFixed(1) + " s";
  function show(frame) {
    held = frame.held;
    const replayed = frame.replay && frame.state !== "ended", running = replayed ? (held ? "replay, paused" : "replay") : frame.state;
    name(by("state"), frame.stop && frame.state !== "ended" ? "stopping" : running);
    by("hold").dataset.held = held;
    by("hold").hidden = !(about.learns || frame.replay);
    name(by("hold"), frame.replay ? (held ? "Play" : "Pause") : held ? "Resume learning" : "Hold learning");
    name(by("stop"), frame.replay ? "End" : "STOP");
    tape(frame);
    const late = frame.late_us == null ? "-" : "99 % within " + frame.late_us + " µs";
    const figures = [["time", seconds(frame.time)], ["left", frame.left == null ? "-" : seconds(frame.left)], ["late", late], ["overruns", frame.overruns], ["refused requests", refused(frame.refused)]];
    frame.axes.forEach((axis, i) => figures.push(["rms error" + (frame.axes.length > 1 ? " " + about.axes[i].name : ""), axis.rmse == null ? "-" : (1e3 * axis.rmse).toPrecision(3) + " nm"]));
    by("figures").replaceChildren(...figures.map(([name, value]) => { const row = element("div", ""); row.append(element("dt", name), element("dd", value)); return row; }));
    frame.axes.forEach((axis, i) => {
      const panel = panels[i], x = axis.desired.map((_, k) => axis.start + k * axis.step), [low, high] = panel.axis.limits;
      if (panel.goal && x.length) { // where it is: Go moves nothing yet
        panel.goal.value ||= Number((axis.desired.at(-1) ?? 0).toFixed(3));
        panel.goal = null;
      }
      panel.flags.textContent = about.flags.filter((_, bit) => axis.flags & (1 << bit)).map((name) => name.replaceAll("_", " ")).join(", ");
      panel.motion.setData([x, axis.desired, axis.measured]);
      panel.error.setData([x, axis.error.map((e) => (e == null ? null : 1e3 * e))]);
      panel.volts.setData([x, axis.volts, x.map(() => low), x.map(() => high)]);
      const seen = axis.measured.concat(axis.desired).filter((v) => v != null);
      if (seen.length) panel.loop(...axis.loop, [low, high], [Math.min(...seen), Math.max(...seen)]);
    });
    document.body.dataset.frames = ++last;
  }

  async function read() {
    const answer = await fetch("/stream", { headers: authorization });
    if (!answer.ok) throw new Error((await answer.json()).error);
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let rest = "", done, value; ;) {
      ({ done, value } = await reader.read());
      if (done) return;
      const parts = (rest + value).split("\n");
      rest = parts.pop();
      if (!parts.length) continue;
      if (parts[0].startsWith('{"flags"') || parts[0].includes('"control"')) { about = JSON.parse(parts.shift()); prepare(); say(""); }
      if (parts.length && about) { const newest = JSON.parse(parts[parts.length - 1]); requestAnimationFrame(() => show(newest)); }
    }
  }

  async function follow() { // the run may be started again at the same place
    for (;;) {
      try { await read(); } catch (error) { say(error instanceof TypeError ? "" : error.message); }
      if (by("state").textContent !== "ended") by("state").textContent = "connection lost, trying again";
      await new Promise((resolve) => setTimeout(resolve, 1000));
    }
  }

  by("stop").addEventListener("click", () => ask({ do: "stop" }));
  by("hold").addEventListener("click", () => ask({ do: held ? "resume" : "hold" }));
  by("time").addEventListener("input", wind);
  by("pace").addEventListener("input", () => { wound = performance.now(); ask({ do: "pace", factor: Number(by("pace").value) }); });
  addEventListener("hashchange", () => location.reload());
  follow();
})();
