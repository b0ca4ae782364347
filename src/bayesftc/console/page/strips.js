// Strips of signals: a buffer of rows with bounded length, and a uPlot for each strip.

export class Buffer {
  constructor(columns) {
    this.columns = columns;
    this.index = new Map(columns.map(([lane, name], i) => [`${lane} ${name}`, i]));
    this.count = 0;
    this.room = 4096;
    this.t = new Float64Array(this.room);
    this.values = columns.map(() => new Float32Array(this.room));
  }

  append(times, rows, columns) {
    const n = times.length;
    if (this.count + n > this.room) this.grow(n);
    this.t.set(times, this.count);
    for (let c = 0; c < this.values.length; c++) this.values[c].set(columns.subarray(c * rows, c * rows + rows), this.count);
    this.count += n;
  }

  grow(n) {
    if (this.count > 30000) this.thin();
    while (this.count + n > this.room) this.room *= 2;
    const t = new Float64Array(this.room);
    t.set(this.t.subarray(0, this.count));
    this.t = t;
    this.values = this.values.map((old) => { const v = new Float32Array(this.room); v.set(old.subarray(0, this.count)); return v; });
  }

  // Reduce the older half: of four rows two remain, with the smallest and the largest value of each column.
  thin() {
    const half = Math.floor(this.count / 8) * 4, rest = this.count - half;
    for (const v of this.values) {
      for (let i = 0, o = 0; i < half; i += 4, o += 2) {
        const [a, b] = ends(v, i, i + 4);
        v[o] = a; v[o + 1] = b;
      }
      v.copyWithin(half / 2, half, this.count);
    }
    for (let i = 0, o = 0; i < half; i += 4, o += 2) { this.t[o] = this.t[i]; this.t[o + 1] = this.t[i + 2]; }
    this.t.copyWithin(half / 2, half, this.count);
    this.count = half / 2 + rest;
  }

  column(lane, name) { return this.values[this.index.get(`${lane} ${name}`)]; }

  last(lane, name) {
    const v = this.column(lane, name);
    return v && this.count ? v[this.count - 1] : NaN;
  }

  from(time) { // the first row at or after a time
    let a = 0, b = this.count;
    while (a < b) { const m = (a + b) >> 1; if (this.t[m] < time) a = m + 1; else b = m; }
    return a;
  }
}

function ends(v, from, to) {
  let low = NaN, high = NaN, lowAt = from, highAt = from;
  for (let i = from; i < to; i++) {
    if (!(v[i] >= low)) { if (v[i] === v[i]) { low = v[i]; lowAt = i; } }
    if (!(v[i] <= high)) { if (v[i] === v[i]) { high = v[i]; highAt = i; } }
  }
  return lowAt <= highAt ? [low, high] : [high, low];
}

// Rows [from, to) of a column in at most about 2 * width points, for drawing.
function drawn(v, from, to, width, scale) {
  const n = to - from, out = [];
  const size = n > 3 * width ? Math.ceil(n / width) : 1;
  for (let i = from; i < to; i += size) {
    if (size === 1) { const x = v[i]; out.push(x === x ? x * scale : null); continue; }
    for (const x of ends(v, i, Math.min(i + size, to))) out.push(x === x ? x * scale : null);
  }
  return out;
}

const UNITS = [["d", 86400], ["h", 3600], ["min", 60]];
const WINDOWS = [20, 60, 300, 1200, 3600, 14400, 43200, 86400, 345600, 864000, 2592000, 8640000];

// The unit of time axes over so many seconds, and its seconds.
export function unitOf(seconds) { return UNITS.find(([, size]) => seconds >= 3 * size) || ["s", 1]; }

function spoken(seconds) {
  const [unit, size] = UNITS.find(([, each]) => seconds >= each && seconds % each === 0) || ["s", 1];
  return `${seconds / size} ${unit}`;
}

// Windows for a sample time, from short to long: the second one shows some hundred samples.
export function windows(step) {
  const usual = WINDOWS.find((each) => each >= 200 * step) || WINDOWS[WINDOWS.length - 1];
  return [usual / 4, usual, 3 * usual, 15 * usual].map((each) => [each, spoken(each)]);
}

// Distances of ticks in a unit: 1, 2 and 5 times powers of ten, halves and quarters of a minute or an hour included.
function distances(size) {
  if (size === 1) return undefined;
  const some = [];
  for (let power = 1; power < 1e6; power *= 10) for (const each of [1, 2, 5]) some.push(each * power * size);
  return [size / 4, size / 2, ...some];
}

function times(t, from, to, width) {
  const n = to - from, out = [];
  const size = n > 3 * width ? Math.ceil(n / width) : 1;
  for (let i = from; i < to; i += size) {
    out.push(t[i]);
    if (size > 1) out.push(t[Math.min(i + (size >> 1), to - 1)]);
  }
  return out;
}

export function colour(name) { return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim(); }

export function look(series) {
  const by = { reference: ["reference", 2, [6, 4]], truth: ["truth", 2, []], belief: ["belief", 1.5, [4, 3]],
    control: ["truth", 1.5, []], received: ["s0", 1.5, [4, 3]], actuator: ["truth", 1.5, [5, 3]], extra: ["s3", 1.5, []] };
  if (series.look === "sensor") return [colour(`s${series.number % 5}`), series.thin ? 1 : 1.5, []];
  const [name, width, dash] = by[series.look] || by.extra;
  return [colour(name), width, dash];
}

export class Strip {
  constructor(place, plan, lanes) {
    this.plan = plan;
    // In each further lane only what is true, and what the plant receives, is drawn: more lines hide each other.
    this.lines = plan.series.map((s) => ({ ...s, lane: 0 }));
    const shown = plan.series.filter((s) => ["truth", "control"].includes(s.look));
    lanes.slice(1).forEach((lane, i) => shown.forEach((s) => this.lines.push({ ...s, lane: i + 1, label: `${s.label}, ${lane.title}`, beside: i })));
    this.element = document.createElement("div");
    this.element.className = "strip";
    const title = document.createElement("h3");
    title.textContent = plan.unit ? `${plan.title} in ${plan.unit}` : plan.title;
    const key = document.createElement("ul");
    key.className = "key";
    this.chart = document.createElement("div");
    this.chart.setAttribute("role", "img");
    this.element.append(title, key, this.chart);
    place.append(this.element);
    this.key = key;
    this.unit = unitOf(0);
    this.build();
  }

  style(line) {
    if (line.beside !== undefined) return [line.beside ? colour("s4") : colour("beside"), 2, [2, 3]];
    return look(line);
  }

  build() {
    if (this.plot) this.plot.destroy();
    const axis = { stroke: colour("faint"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid"), width: 1 }, font: "12px system-ui" };
    const range = this.plan.range, [unit, size] = this.unit;
    const clock = size === 1 ? {} : { incrs: distances(size), values: (plot, at) => at.map((t) => `${short(t / size)} ${unit}`), space: 70 };
    this.key.replaceChildren();
    const series = this.lines.map((line) => {
      const [stroke, width, dash] = this.style(line);
      const item = document.createElement("li"), mark = document.createElement("i");
      mark.style.borderTopColor = stroke;
      mark.style.borderTopStyle = dash.length ? "dashed" : "solid";
      item.append(mark, document.createTextNode(line.label));
      this.key.append(item);
      const dots = line.look === "sensor" && !range;
      return dots
        ? { stroke, width: 0, paths: () => null, points: { show: true, size: 3, fill: stroke, width: 0 } }
        : { stroke, width, dash, points: { show: false } };
    });
    this.width = Math.max(this.chart.clientWidth, 200);
    this.plot = new uPlot({
      width: this.width, height: this.plan.range ? 130 : 150, legend: { show: false }, cursor: { show: false }, select: { show: false },
      scales: { x: { time: false }, y: range ? { range: [range[0] - 0.04, range[1] + 0.04] } : {} },
      axes: [{ ...axis, size: 28, ...clock }, { ...axis, size: 52, space: 26 }],
      series: [{}, ...series],
    }, [[0, 1], ...this.lines.map(() => [null, null])], this.chart);
  }

  show(buffer, begin, end) {
    const from = Math.max(buffer.from(begin) - 1, 0), to = buffer.count;
    if (this.chart.clientWidth && Math.abs(this.chart.clientWidth - this.width) > 1) {
      this.width = this.chart.clientWidth;
      this.plot.setSize({ width: this.width, height: this.plot.height });
    }
    const unit = unitOf(end - begin);
    if (unit[1] !== this.unit[1]) { this.unit = unit; this.build(); }
    const x = times(buffer.t, from, to, this.width);
    const ys = this.lines.map((line) => {
      const v = buffer.column(line.lane, line.column);
      return v ? drawn(v, from, to, this.width, line.scale || 1) : x.map(() => null);
    });
    this.plot.batch(() => {
      this.plot.setData([x, ...ys], true);
      this.plot.setScale("x", { min: begin, max: Math.max(end, begin + 1e-9) });
    });
    const now = this.lines.map((line) => `${line.label} ${short(buffer.last(line.lane, line.column) * (line.scale || 1))}`);
    if (!this.said || performance.now() - this.said > 2000) {
      this.said = performance.now();
      this.chart.setAttribute("aria-label", `${this.plan.title}: ${now.join(", ")}`);
    }
  }

  remove() { this.plot.destroy(); this.element.remove(); }
}

export function short(x) {
  if (!Number.isFinite(x)) return "none";
  const size = Math.abs(x);
  return size !== 0 && (size >= 1e5 || size < 1e-3) ? x.toExponential(2) : x.toPrecision(4).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
}
