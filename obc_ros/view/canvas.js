// Copyright 2026 The obc_ros developers
// SPDX-License-Identifier: Apache-2.0
// Draws a body in its plane and the signals of a loop over time. All texts go to canvases: none
// of them can become markup.
const WINDOW = 20; // [s] of signals
const TRAIL = 900; // points behind the body
const ACK = 10; // frames between two acknowledgements
const [LEFT, RIGHT] = [52, 96]; // [px] beside a panel
const PANEL = 84; // [px] height of a panel of signals
const SLOW = 3; // frames of the body for one of the signals
const [TRAIL_COLOUR, PLAN, REFERENCE] = ["#0072B2", "#009E73", "#CC79A7"];
const [PREDICTION, ELLIPSE] = ["#E69F00", "#56B4E9"];
const BAND = "38"; // opacity of the surface of a band or an ellipse
const JUMP = 100; // ratio of scales from which the plane does not move smoothly
const SAID = 1000; // [ms] between two texts for screen readers
const WIND = "#A86400";
const GOAL = "#D55E00";
const CLOCK = 1e8; // [s] from which a time is that of a clock: three years of simulated time
const STALE = 1000; // [ms] without a frame, after which the picture says so

const sayTime = (t, digits) =>
  t < CLOCK ? t.toFixed(digits) : new Date(1000 * t).toTimeString().slice(0, 8);
const finite = (rows) => rows.filter((row) => row.every(Number.isFinite));

export default {
  template: `<div class="obc-view">
    <canvas ref="plane" class="obc-plane" role="img" aria-label="no state yet" @click="click"></canvas>
    <canvas ref="plots" class="obc-plots" role="img" aria-label="signals over the last 20 s, set points dashed"></canvas>
  </div>`,
  props: { scene: Object, live: Boolean },
  watch: {
    scene() {
      this.read();
      this.draw();
    },
  },
  mounted() {
    this.read();
    this.frames = [];
    this.path = [];
    this.reference = [];
    this.prediction = [];
    this.box = null;
    this.drawing = false;
    this.settled = true;
    this.drawn = 0;
    this.said = -Infinity;
    this.arrived = 0;
    // A connection that dies sends nothing more: the page looks at its own clock.
    this.clock = setInterval(() => this.sayStale() && this.draw(true), STALE / 2);
    this.observer = new ResizeObserver(() => this.draw(true));
    this.observer.observe(this.$el);
  },
  unmounted() {
    clearInterval(this.clock);
    this.observer.disconnect();
  },
  methods: {
    // A copy without Vue's proxies: these took more time than the lines.
    read() {
      this.plain = JSON.parse(JSON.stringify(this.scene));
      this.drawn = 0;
    },
    push(frame, age = 0) {
      const last = this.frames[this.frames.length - 1];
      if (last && frame.t < last.t) [this.frames, this.prediction] = [[], []];
      if (frame.prediction) this.prediction = finite(frame.prediction);
      this.arrived = performance.now() - 1000 * age;
      this.frames.push(frame);
      if (this.frames.length > TRAIL) this.frames.splice(0, this.frames.length - TRAIL);
      if (frame.n % ACK === 0) this.$emit("ack", frame.n);
      this.draw();
    },
    plan(points) {
      this.path = points;
      this.draw();
    },
    refer(rows) {
      this.reference = finite(rows);
      this.draw(true);
    },
    // How long no frame has come; empty: not long, or a recording, which may be paused.
    sayStale() {
      const age = performance.now() - this.arrived;
      return this.live && this.frames.length && age > STALE
        ? `no new state for ${Math.floor(age / 1000)} s` : "";
    },
    // The place of a state or a set point; null: not known.
    locate(values) {
      const place = [values[this.plain.plane.x], values[this.plain.plane.y]];
      return place.every(Number.isFinite) ? place : null;
    },
    // The places of the reference, or of the prediction, that are still ahead.
    ahead(rows, frame) {
      const { x, y } = this.plain.plane;
      return rows.filter((row) => !frame || row[0] >= frame.t)
        .map((row) => [row[1 + x], row[1 + y]]);
    },
    draw(all = false) {
      if (all) this.drawn = 0;
      if (this.drawing) return;
      this.drawing = true;
      requestAnimationFrame(() => {
        this.drawing = false;
        if (!this.$refs.plane) return;
        this.drawPlane();
        if (this.drawn++ % SLOW === 0) this.drawPlots();
        // A loop brings the next frame; a recording that is paused has only this one.
        if (!this.live && !this.settled) this.draw();
      });
    },
    prepare(canvas, height) {
      const ratio = window.devicePixelRatio || 1;
      const width = this.$el.clientWidth;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
        canvas.style.height = height + "px";
      }
      const context = canvas.getContext("2d");
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      const dark = document.body.classList.contains("body--dark");
      const colours = dark
        ? { paper: "#15181c", ink: "#e6e9ec", grid: "#343a40", faint: "#9aa3ab", warn: "#ff9b66" }
        : { paper: "#ffffff", ink: "#1b1f24", grid: "#dde2e6", faint: "#5c656d", warn: "#b03a00" };
      this.paper = colours.paper;
      context.fillStyle = colours.paper;
      context.fillRect(0, 0, width, height);
      context.font = "12px system-ui, sans-serif";
      return { context, width, height, colours };
    },
    drawPlane() {
      const plane = this.plain.plane;
      this.$refs.plane.style.display = plane ? "block" : "none";
      if (!plane) return;
      const height = Math.max(220, Math.min(430, this.$el.clientWidth * 0.62));
      const { context, width, colours } = this.prepare(this.$refs.plane, height);
      const frame = this.frames[this.frames.length - 1];
      const trail = this.frames.map((f) => this.locate(f.x)).filter(Boolean);
      const [here, goal] = frame ? [this.locate(frame.x), this.locate(frame.goal)] : [null, null];
      const ahead = this.ahead(this.reference, frame);
      const predicted = this.ahead(this.prediction, frame);
      if (here && predicted.length) predicted.unshift(here);
      this.follow([...this.path, ...ahead, ...predicted, ...trail.slice(-90), ...(goal ? [goal] : [])],
        width, height);
      const [left, bottom, scale] = this.box;
      const place = (x, y) => [(x - left) * scale, height - (y - bottom) * scale];
      const rows = [["trail", TRAIL_COLOUR, []],
        ...(goal ? [["set point", GOAL, []]] : []),
        ...(this.path.length ? [["plan", PLAN, [6, 4]]] : []),
        ...(ahead.length ? [["reference", REFERENCE, [2, 3]]] : []),
        ...(predicted.length ? [["prediction", PREDICTION, []]] : []),
        ...(here && frame.ellipse.length ? [["95 % region", ELLIPSE, []]] : []),
        ...(frame ? frame.acting : []).map((words) => [words, WIND, []])];
      const time = frame ? `t = ${sayTime(frame.t, 1)}${frame.t < CLOCK ? " s" : ""}` : "";
      context.font = "14px system-ui, sans-serif";
      const after = 18 + context.measureText(time).width;
      // What is written over the grid keeps the numbers of the grid away.
      const taken = [[width - 122, 0, width, 16 * rows.length + 8],
        [0, 0, after + (this.sayStale() ? 150 : 0), 25]];
      this.drawGrid(context, width, height, colours, place, taken);
      this.line(context, this.path.map((p) => place(p[0], p[1])), PLAN, [6, 4], 2);
      this.line(context, ahead.map((p) => place(p[0], p[1])), REFERENCE, [2, 3], 2.5);
      this.line(context, trail.map((p) => place(p[0], p[1])), TRAIL_COLOUR, [], 1.5);
      this.drawKey(context, width, colours, rows);
      if (!frame) return;
      if (here && frame.ellipse.length) this.drawEllipse(context, frame.ellipse, place(...here), scale);
      if (goal) this.drawGoal(context, place(...goal));
      if (here) this.drawBody(context, frame, place, colours);
      if (here && frame.push.length) this.drawPush(context, frame.push, place(...here));
      this.line(context, predicted.map((p) => place(p[0], p[1])), PREDICTION, [], 2.5);
      this.say(frame, predicted);
      context.fillStyle = colours.ink;
      context.font = "14px system-ui, sans-serif";
      this.ink(context, time, 10, 20);
      context.fillStyle = colours.warn;
      context.font = "12px system-ui, sans-serif";
      this.ink(context, this.sayStale(), after, 20);
    },
    drawKey(context, width, colours, rows) {
      context.font = "12px system-ui, sans-serif";
      context.fillStyle = colours.ink;
      rows.forEach(([name, colour, dash], i) => {
        const y = 16 + 16 * i;
        this.line(context, [[width - 118, y], [width - 88, y]], colour, dash, 2.5);
        context.fillText(name, width - 80, y + 4, 78);
      });
    },
    say(frame, predicted) {
      const now = performance.now();
      if (now < this.said + SAID) return;
      this.said = now;
      const words = [this.sayStale()].filter(Boolean).concat(this.plain.states.map((s, i) => `${s.name} ${(frame.x[i] ?? NaN).toFixed(2)} ${s.unit}`));
      words.push(...frame.acting);
      const [x, y] = predicted[predicted.length - 1] || [];
      if (predicted.length) words.push(`predicted: px ${x.toFixed(2)}, py ${y.toFixed(2)}`);
      const [a, b] = frame.ellipse;
      if (frame.ellipse.length) words.push(`95 % region: half axes ${b.toFixed(2)} m and ${a.toFixed(2)} m`);
      this.$refs.plane.setAttribute("aria-label", words.join(", "));
    },
    // Moves the visible part of the plane towards the one that shows all points.
    follow(points, width, height) {
      if (!points.length) points.push([0, 0]);
      const xs = points.map((p) => p[0]);
      const ys = points.map((p) => p[1]);
      const [x0, x1] = [Math.min(...xs), Math.max(...xs)];
      const [y0, y1] = [Math.min(...ys), Math.max(...ys)];
      const size = this.plain.size;
      const scale = Math.min(width / (x1 - x0 + 1.2 * size), height / (y1 - y0 + 1.2 * size));
      const wanted = [(x0 + x1) / 2 - width / scale / 2, (y0 + y1) / 2 - height / scale / 2, scale];
      if (!wanted.every(Number.isFinite) || !(scale > 0)) {
        this.box ||= [0, 0, height / size]; // the points are too far from each other
        this.settled = true;
        return;
      }
      const zoom = this.box ? scale / this.box[2] : Infinity;
      const isNear = Math.max(zoom, 1 / zoom) < JUMP;
      const [dx, dy] = [0, 1].map((i) => Math.abs(wanted[i] - (this.box ?? wanted)[i]) * scale);
      this.settled = !isNear || (dx < 1 && dy < 1 && Math.abs(zoom - 1) < 0.005);
      this.box = isNear ? this.box.map((v, i) => v + 0.12 * (wanted[i] - v)) : wanted;
    },
    // Writes a text unless it would touch another one; `taken` has the edges of all of them.
    write(context, taken, text, x, y) {
      const [right, top, bottom] = [x + context.measureText(text).width, y - 10, y + 3];
      if (x < 0 || right > this.$el.clientWidth || taken.some((box) =>
        x - 4 < box[2] && box[0] < right + 4 && top < box[3] && box[1] < bottom)) return;
      taken.push([x, top, right, bottom]);
      this.ink(context, text, x, y);
    },
    // Writes a text with a margin of paper: no line of a grid strikes it through.
    ink(context, text, x, y) {
      context.strokeStyle = this.paper;
      context.lineWidth = 4;
      context.lineJoin = "round";
      context.strokeText(text, x, y);
      context.fillText(text, x, y);
    },
    drawGrid(context, width, height, colours, place, taken) {
      const [left, bottom, scale] = this.box;
      const step = this.round(90 / scale);
      context.strokeStyle = colours.grid;
      context.fillStyle = colours.faint;
      context.lineWidth = 1;
      context.font = "11px system-ui, sans-serif";
      const digits = this.count(step);
      const { x, y } = this.plain.plane;
      const name = (s) => `${s.name} [${s.unit}]`;
      const below = name(this.plain.states[x]);
      const texts = [[below, width - 4 - context.measureText(below).width, height - 5],
        [name(this.plain.states[y]), 3, 38]];
      // Counted, as x + step is x for a very large x.
      for (let i = 0; i < width / 90 + 1; i++) {
        const x = (Math.ceil(left / step) + i) * step;
        const [px] = place(x, 0);
        this.line(context, [[px, 0], [px, height]], colours.grid, [], 1);
        texts.push([x.toFixed(digits), px + 3, height - 5]);
      }
      for (let i = 0; i < height / 90 + 1; i++) {
        const y = (Math.ceil(bottom / step) + i) * step;
        const [, py] = place(0, y);
        this.line(context, [[0, py], [width, py]], colours.grid, [], 1);
        texts.push([y.toFixed(digits), 3, py - 3]);
      }
      texts.forEach((each) => this.write(context, taken, ...each));
    },
    // The decimals of multiples of a step.
    count(step) {
      return Math.max(0, -Math.floor(Math.log10(step)));
    },
    round(value) {
      const power = Math.pow(10, Math.floor(Math.log10(value)));
      return power * [1, 2, 5, 10].find((m) => m * power >= value);
    },
    drawGoal(context, [x, y]) {
      this.line(context, [[x - 9, y], [x + 9, y]], GOAL, [], 2.5);
      this.line(context, [[x, y - 9], [x, y + 9]], GOAL, [], 2.5);
    },
    // An arrow towards the body, where a disturbance pushes it.
    drawPush(context, [dx, dy], [x, y]) {
      const size = Math.hypot(dx, dy);
      const [c, s] = [dx / size, -dy / size];
      const at = (along, across) => [x + along * c - across * s, y + along * s + across * c];
      this.line(context, [at(-84, 0), at(-36, 0)], WIND, [], 5);
      this.fill(context, [at(-22, 0), at(-40, 10), at(-40, -10)], WIND, "none");
    },
    drawEllipse(context, [a, b, angle], [x, y], scale) {
      context.beginPath();
      context.ellipse(x, y, a * scale, b * scale, -angle, 0, 2 * Math.PI);
      context.fillStyle = ELLIPSE + BAND;
      context.fill();
      context.strokeStyle = ELLIPSE;
      context.lineWidth = 2;
      context.stroke();
    },
    drawBody(context, frame, place, colours) {
      const plane = this.plain.plane;
      const [ox, oy] = [frame.x[plane.x], frame.x[plane.y]];
      const angle = plane.theta === null ? 0 : frame.x[plane.theta];
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      const turn = ([x, y]) => place(ox + c * x - s * y, oy + s * x + c * y);
      if (this.plain.plume && frame.u.length === 2) {
        const [f1, f2] = frame.u.map((f) => -f * this.plain.plume);
        const length = Math.hypot(f1, f2) || 1;
        const side = [-f2 / length * 0.035, f1 / length * 0.035];
        this.fill(context, [[side[0], -this.plain.arm + side[1]], [f1, f2 - this.plain.arm],
          [-side[0], -this.plain.arm - side[1]]].map(turn), "#E69F00", "none");
      }
      if (this.plain.body.length) {
        this.plain.body.forEach((part) =>
          this.fill(context, part.points.map(turn), part.colour, "#1b1f24"));
      } else {
        const [x, y] = place(ox, oy);
        context.beginPath();
        context.arc(x, y, 6, 0, 2 * Math.PI);
        context.fillStyle = "#56B4E9";
        context.fill();
        context.strokeStyle = colours.ink;
        context.stroke();
      }
    },
    fill(context, points, colour, edge) {
      context.beginPath();
      points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.closePath();
      context.fillStyle = colour;
      context.fill();
      if (edge === "none") return;
      context.strokeStyle = edge;
      context.lineWidth = 1;
      context.stroke();
    },
    line(context, points, colour, dash, width) {
      if (points.length < 2) return;
      context.beginPath();
      points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.setLineDash(dash);
      context.stroke();
      context.setLineDash([]);
    },
    drawPlots() {
      const panels = this.plain.panels;
      const { context, width, colours } = this.prepare(
        this.$refs.plots, panels.length * PANEL + 18);
      const last = this.frames[this.frames.length - 1];
      const end = last ? last.t : 0;
      const shown = this.frames.filter((f) => f.t > end - WINDOW);
      const [first, final] = [this.prediction[0], this.prediction[this.prediction.length - 1]];
      // The axis of time goes on for the length of a plan: it moves less than the end of the plan.
      const later = final && final[0] > end
        ? Math.max(0, Math.min(final[0] - first[0], WINDOW / 2)) : 0;
      const { times, digits } = this.ticks(end, later, width);
      panels.forEach((panel, row) =>
        this.drawPanel(context, panel, row, shown, end, later, width, colours, times));
      this.drawMarks(context, end, later, width, colours);
      const [taken, bottom] = [[], panels.length * PANEL + 13];
      context.font = "11px system-ui, sans-serif";
      context.fillStyle = colours.warn;
      this.write(context, taken, this.sayStale(), 4, bottom);
      context.fillStyle = colours.faint;
      const name = end < CLOCK ? "time [s]" : "time";
      this.write(context, taken, name, width - 4 - context.measureText(name).width, bottom);
      const px = this.project(end, later, width);
      times.forEach((t) => {
        const text = sayTime(t, digits);
        this.write(context, taken, text, px(t) - context.measureText(text).width / 2, bottom);
      });
    },
    // The events of a recording: a line through all panels, the words where they have room.
    drawMarks(context, end, later, width, colours) {
      const [px, edge] = [this.project(end, later, width), width - RIGHT];
      const taken = [[edge, 0, width, PANEL]];
      context.font = "11px system-ui, sans-serif";
      context.fillStyle = colours.ink;
      this.plain.marks.filter(([t]) => t > end - WINDOW && t <= end).forEach(([t, words]) => {
        const height = this.plain.panels.length * PANEL - 8;
        this.line(context, [[px(t), 8], [px(t), height]], colours.ink, [1, 2], 1.5);
        this.write(context, taken, words, px(t) + 4, 20);
      });
    },
    // From a time to its place in the plots, whose axis ends `later` [s] after the present one.
    project(end, later, width) {
      return (t) => width - RIGHT - (end + later - t) / (WINDOW + later) * (width - LEFT - RIGHT);
    },
    // The round times in the plots, and their decimals.
    ticks(end, later, width) {
      const step = this.round(48 * (WINDOW + later) / Math.max(width - LEFT - RIGHT, 48));
      const first = Math.ceil((end - WINDOW) / step - 1e-9);
      const times = Array.from({ length: Math.floor((WINDOW + later) / step) + 2 },
        (_, i) => (first + i) * step).filter((t) => t < end + later + 1e-6);
      return { times, digits: this.count(step) };
    },
    drawPanel(context, panel, row, frames, end, later, width, colours, times) {
      const [left, right, top, height] = [LEFT, width - RIGHT, row * PANEL + 8, PANEL - 16];
      const value = (f, s) => (s.of === "cost" ? f.cost : s.of === "latency" ? f.latency : f[s.of][s.index]);
      const values = frames.flatMap((f) => panel.signals.map((s) => value(f, s))).filter(Number.isFinite);
      const passed = this.reference.filter((row) => row[0] > end - WINDOW && row[0] <= end);
      const followed = panel.signals.filter((s) => s.of === "x").map((s) => 1 + s.index);
      passed.forEach((row) => followed.forEach((k) => values.push(row[k])));
      // While a reference is followed, the set point is where it ends.
      const held = passed.length ? [] : panel.signals.filter((s) => s.of === "x").map((s) =>
        [s, frames.filter((f) => Number.isFinite(f.goal[s.index]))]);
      held.forEach(([s, known]) => known.forEach((f) => values.push(f.goal[s.index])));
      const ahead = this.predict(panel, frames[frames.length - 1], value);
      ahead.forEach((points) => points.forEach((p) => values.push(p[1])));
      const banded = (s) => frames.filter(
        (f) => s.of === "x" && f.band.length && Number.isFinite(value(f, s)));
      panel.signals.forEach((s) => banded(s).forEach((f) =>
        values.push(value(f, s) - f.band[s.index], value(f, s) + f.band[s.index])));
      panel.limits.forEach((l) => {
        if (values.some((v) => Math.abs(v - l) < 0.5 * Math.abs(l) + 1e-9)) values.push(l);
      });
      let [low, high] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
      const margin = Math.max(0.08 * (high - low), panel.floor);
      const least = panel.signals.every((s) => s.of === "cost" || s.of === "latency") ? 0 : -Infinity;
      [low, high] = [Math.max(low - margin, least), high + margin];
      const px = this.project(end, later, width);
      const py = (v) => top + (high - v) / (high - low) * height;
      frames.forEach((f, i) => {
        const [from, to] = [px(f.t), px((frames[i + 1] || f).t)];
        if (f.gust) this.fill(context, [[from, top], [to, top], [to, top + height],
          [from, top + height]], WIND + BAND, "none");
      });
      times.forEach((t) =>
        this.line(context, [[px(t), top], [px(t), top + height]], colours.grid, [], 1));
      context.strokeStyle = colours.grid;
      context.strokeRect(left, top, right - left, height);
      context.fillStyle = colours.faint;
      context.font = "11px system-ui, sans-serif";
      context.fillText(high.toPrecision(3), 4, top + 10);
      context.fillText(low.toPrecision(3), 4, top + height);
      context.fillText(panel.unit, 4, top + height / 2 + 4);
      panel.limits.filter((l) => l > low && l < high).forEach((l) =>
        this.line(context, [[left, py(l)], [right, py(l)]], colours.faint, [4, 3], 1));
      followed.forEach((k) => this.line(
        context, passed.map((row) => [px(row[0]), py(row[k])]), REFERENCE, [2, 3], 1.2));
      if (later) this.line(context, [[px(end), top], [px(end), top + height]], colours.faint, [1, 3], 1);
      panel.signals.forEach((s) => {
        const edge = (sign) => (f) => [px(f.t), py(value(f, s) + sign * f.band[s.index])];
        const shown = banded(s);
        if (shown.length > 1) this.fill(context,
          [...shown.map(edge(1)), ...shown.reverse().map(edge(-1))], s.colour + BAND, "none");
      });
      held.forEach(([s, known]) => this.line(context,
        known.map((f) => [px(f.t), py(f.goal[s.index])]), s.colour, [6, 4], 1));
      ahead.forEach((points, i) => this.line(context, points.map(([t, v]) => [px(t), py(v)]),
        panel.signals[i].colour, [2, 2], 1.2));
      panel.signals.forEach((s, i) => {
        const points = frames.filter((f) => Number.isFinite(value(f, s)))
          .map((f) => [px(f.t), py(value(f, s))]);
        this.line(context, points, s.colour, s.dash, 1.7);
        context.fillStyle = colours.ink;
        this.line(context, [[right + 6, top + 8 + 14 * i], [right + 24, top + 8 + 14 * i]], s.colour, s.dash, 2);
        context.fillText(s.name, right + 28, top + 12 + 14 * i);
      });
    },
    // The predicted values of each signal of a panel, from the last frame on.
    predict(panel, frame, value) {
      const column = { x: 1, u: 1 + this.plain.states.length };
      return panel.signals.map((s) => (frame && s.of in column ? this.prediction
        .filter((row) => row[0] > frame.t).map((row) => [row[0], row[column[s.of] + s.index]]) : []))
        .map((points, i) => (points.length && Number.isFinite(value(frame, panel.signals[i]))
          ? [[frame.t, value(frame, panel.signals[i])], ...points] : points));
    },
    click(event) {
      if (!this.box) return;
      const [left, bottom, scale] = this.box;
      const area = this.$refs.plane.getBoundingClientRect();
      this.$emit("goal", {
        x: left + (event.clientX - area.left) / scale,
        y: bottom + (area.bottom - event.clientY) / scale,
      });
    },
  },
};
