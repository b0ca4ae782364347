// The loop as a drawing with live values on its wires, and the moving pictures of the plants.
import { colour, short } from "/page/strips.js";

const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

export class Loop {
  constructor(place, layout) {
    this.parts = [];
    this.boxes = new Map();
    const sensors = layout.devices.filter((d) => d.id.startsWith("sensor"));
    const actuators = layout.devices.filter((d) => d.id.startsWith("actuator"));
    const rows = Math.max(Math.min(sensors.length, 4), 1), height = 150 + 34 * rows;
    const svg = element("svg", { viewBox: `0 0 360 ${height}`, role: "img", "aria-label": "The closed loop with its present values" });
    const box = (x, y, w, h, text, id) => {
      const rect = element("rect", { x, y, width: w, height: h, rx: 6 });
      svg.append(rect, element("text", { x: x + w / 2, y: y + h / 2 + 4, "text-anchor": "middle" }, text));
      if (id) this.boxes.set(id, rect);
    };
    const arrow = (d, x, y, direction) => {
      const head = { right: "l-7,-4 v8 z", left: "l7,-4 v8 z", down: "l-4,-7 h8 z", up: "l-4,7 h8 z" }[direction];
      svg.append(element("path", { d }), element("path", { d: `M${x},${y} ${head}`, class: "head" }));
    };
    const value = (x, y, anchor, column, unit, scale) => {
      const text = element("text", { x, y, "text-anchor": anchor }), number = element("tspan", { class: "value" }, ""), of = element("tspan", { class: "unit" }, unit ? ` ${unit}` : "");
      text.append(number, of);
      svg.append(text);
      this.parts.push({ number, column, scale: scale || 1 });
    };
    const goals = layout.goals, strips = layout.strips;
    const truths = strips.flatMap((s) => s.series.filter((e) => e.look === "truth").map((e) => ({ ...e, unit: s.unit, title: s.title })));
    const controls = strips.flatMap((s) => s.series.filter((e) => ["control", "received"].includes(e.look)).map((e) => ({ ...e, unit: s.unit })));
    box(4, 24, 76, 40, "reference");
    box(128, 24, 92, 40, "controller");
    arrow("M80,44 H121", 128, 44, "right");
    goals.slice(0, 2).forEach((g, i) => value(84, 18 - 13 * i + 0, "start", g.column, g.unit));
    const ax = 268;
    actuators.slice(0, 1).forEach((a) => box(ax, 24, 88, 40, actuators.length > 1 ? `${actuators.length} actuators` : a.name.replace("actuator ", ""), a.id));
    arrow(`M220,44 H${ax - 7}`, ax, 44, "right");
    controls.filter((c) => c.look === "control").slice(0, 1).forEach((c) => value(352, 18, "end", c.column, c.unit));
    const py = 118, mid = py + 17 * rows;
    box(268, mid - 22, 88, 44, "plant");
    arrow(`M312,64 V${mid - 29}`, 312, mid - 22, "down");
    const received = controls.find((c) => c.look === "received");
    if (received) value(306, 92, "end", received.column, received.unit);
    truths.slice(0, 2).forEach((q, i) => value(312, mid + 38 + 14 * i, "middle", q.column, q.unit));
    sensors.slice(0, rows).forEach((s, i) => {
      const y = py + 34 * i;
      box(166, y, 76, 28, s.name, s.id);
      arrow(`M268,${mid} H254 V${y + 14} H249`, 242, y + 14, "left");
      svg.append(element("path", { d: `M166,${y + 14} H60` }));
      value(158, y + 9, "end", s.column, s.unit);
    });
    const more = sensors.length - rows;
    if (more > 0) svg.append(element("text", { x: 204, y: py + 34 * rows + 8, "text-anchor": "middle", class: "unit" }, `and ${more} more sensor${more > 1 ? "s" : ""}`));
    const last = py + 34 * (rows - 1) + 14;
    arrow(`M60,${last} V84 H174 V71`, 174, 64, "up");
    place.replaceChildren(svg);
  }

  show(buffer, cards) {
    for (const part of this.parts) {
      const x = part.column ? buffer.last(0, part.column) * part.scale : NaN;
      const text = short(x);
      if (part.number.textContent !== text) part.number.textContent = text;
    }
    for (const card of cards) {
      const box = this.boxes.get(card.id);
      if (box) box.setAttribute("class", card.present.length ? "faulty" : card.state);
    }
  }
}

export class Scenes {
  constructor(place, layout) {
    this.layout = layout;
    this.canvases = layout.lanes.map((lane) => {
      const figure = document.createElement("figure"), canvas = document.createElement("canvas"), caption = document.createElement("figcaption");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `Picture of the plant with ${lane.title}`);
      caption.textContent = lane.title;
      figure.append(canvas, caption);
      return { figure, canvas, caption, title: lane.title, low: Infinity, high: -Infinity };
    });
    place.replaceChildren(...this.canvases.map((c) => c.figure));
  }

  show(scenes, buffer, stopped) {
    this.canvases.forEach((each, lane) => {
      const { canvas } = each, ratio = window.devicePixelRatio || 1;
      const w = canvas.clientWidth, h = canvas.clientHeight;
      if (canvas.width !== Math.round(w * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
      const ctx = canvas.getContext("2d");
      ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
      ctx.clearRect(0, 0, w, h);
      const scene = scenes[lane];
      if (scene) this.draw(ctx, w, h, scene);
      else this.gauge(ctx, w, h, each, buffer, lane);
      const text = stopped[lane] ? `${each.title}: stopped` : each.title;
      if (each.caption.textContent !== text) { each.caption.textContent = text; each.caption.title = stopped[lane] || ""; }
    });
  }

  draw(ctx, w, h, scene) {
    const [left, right, bottom, top] = scene.window;
    const scale = Math.min(w / (right - left), h / (top - bottom)) * 0.96;
    const x0 = w / 2 - scale * (left + right) / 2, y0 = h / 2 + scale * (bottom + top) / 2;
    const stroke = (lines, style, width, dash) => {
      ctx.strokeStyle = style; ctx.lineWidth = width; ctx.setLineDash(dash); ctx.lineCap = "round"; ctx.lineJoin = "round";
      for (const line of lines || []) {
        ctx.beginPath();
        for (let i = 0; i < line.length; i += 2) ctx.lineTo(x0 + scale * line[i], y0 - scale * line[i + 1]);
        ctx.stroke();
      }
    };
    stroke(scene.fixed, colour("faint"), 1.5, []);
    stroke(scene.truth, colour("truth"), 2, []);
    stroke(scene.belief, colour("belief"), 1.5, [5, 4]);
  }

  // A scale with the true value, the reference and the belief, for plants without a picture.
  gauge(ctx, w, h, each, buffer, lane) {
    const strip = this.layout.strips.find((s) => s.series.some((e) => ["truth", "belief", "sensor"].includes(e.look)) && !s.range);
    if (!strip) return;
    const marks = strip.series.map((s) => ({ s, x: buffer.last(lane, s.column) * (s.scale || 1) })).filter((m) => Number.isFinite(m.x));
    for (const m of marks) if (m.s.look !== "sensor") { each.low = Math.min(each.low, m.x); each.high = Math.max(each.high, m.x); }
    const span = each.high - each.low || 1, low = each.low - 0.1 * span, high = each.high + 0.1 * span;
    const place = (x) => 14 + (w - 28) * Math.min(Math.max((x - low) / (high - low), 0), 1), y = h / 2;
    ctx.strokeStyle = colour("faint"); ctx.lineWidth = 2; ctx.setLineDash([]);
    ctx.beginPath(); ctx.moveTo(14, y); ctx.lineTo(w - 14, y); ctx.stroke();
    const mark = (look, tall, name, width) => {
      for (const m of marks.filter((each_) => each_.s.look === look)) {
        ctx.strokeStyle = colour(name); ctx.lineWidth = width;
        ctx.beginPath(); ctx.moveTo(place(m.x), y - tall); ctx.lineTo(place(m.x), y + tall); ctx.stroke();
      }
    };
    mark("reference", 22, "reference", 5); mark("belief", 17, "belief", 2); mark("truth", 14, "truth", 3);
    ctx.fillStyle = colour("faint"); ctx.font = "12px system-ui";
    ctx.fillText(short(low), 14, y + 40);
    const end = short(high);
    ctx.fillText(end, w - 14 - ctx.measureText(end).width, y + 40);
    ctx.fillText(strip.unit ? `${strip.title} in ${strip.unit}` : strip.title, 14, y - 32);
  }
}
