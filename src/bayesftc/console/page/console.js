// The console: connection, commands, cards, forms, branches and the log. Names reach the page as text only.
import { Buffer, Strip, short, windows } from "/page/strips.js";
import { Loop, Scenes } from "/page/drawing.js";
import { make, put } from "/page/elements.js";
import { Wires } from "/page/wires.js";

const $ = (id) => document.getElementById(id);

let socket, layout, buffer, state, loop, scenes, strips = [], extra = [], cards = new Map(), waiting = new Map(), number = 0;
let dragging = false, dirty = false, shownLog = "";
const memory = { forms: new Map() };
const wires = new Wires($("wires"), $("wire-list"), act);

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (event) => (typeof event.data === "string" ? onMessage(JSON.parse(event.data)) : onFrame(event.data));
  socket.onclose = (event) => {
    $("status").textContent = event.reason || "The connection has ended. Trying again.";
    enable(false);
    setTimeout(connect, 1000);
  };
}

function send(command) {
  return new Promise((resolve, reject) => {
    if (socket.readyState !== WebSocket.OPEN) { reject(new Error("There is no connection to the console.")); return; }
    const id = ++number;
    waiting.set(id, { resolve, reject });
    socket.send(JSON.stringify({ ...command, id }));
  });
}

async function act(command) {
  try {
    const answer = await send(command);
    if (state && "running" in answer) { state.running = answer.running; put($("run"), answer.running ? "Pause" : "Run"); }
    say("");
    return answer;
  } catch (error) {
    say(error.message);
    return null;
  }
}

function say(text) {
  $("message").textContent = text;
  $("message").hidden = !text;
}

function onMessage(message) {
  if (message.type === "loading") {
    $("status").textContent = message.failure ? "" : "loading the scenario";
    if (message.failure) say(message.failure);
  } else if (message.type === "layout") onLayout(message);
  else if (waiting.has(message.id)) {
    const { resolve, reject } = waiting.get(message.id);
    waiting.delete(message.id);
    if (message.type === "error") reject(new Error(message.sentence));
    else resolve(message);
  } else if (message.type === "error") say(message.sentence);
}

function onFrame(data) {
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  if (!layout || header.epoch !== layout.epoch) return;
  const [rows, columns] = header.shape, at = 4 + length;
  const times = new Float64Array(data, at, rows).map((k) => k * layout.step);
  const values = new Float32Array(data, at + 8 * rows, rows * columns);
  if (header.reset) buffer = new Buffer(header.columns);
  if (!buffer) return;
  buffer.append(times, rows, values);
  if (header.reset) showSettings(); // now present values are known
  state = header;
  dirty = true;
}

function titleOf(lane, i) {
  if (i && lane.branch !== layout.lanes[0].branch) return `in ${lane.branch}`;
  return lane.name === "FixedPrecision" ? "without fault tolerance" : i ? `with ${lane.name}` : lane.name === "the scenario" ? lane.name : `with ${lane.name}`;
}

// Fit the choice of windows to the sample time, once for each.
function showWindows() {
  const fitting = windows(layout.step), choice = $("window");
  if (choice.dataset.usual === String(fitting[1][0])) return;
  choice.dataset.usual = String(fitting[1][0]);
  choice.replaceChildren(...[...fitting, [0, "all"]].map(([seconds, text]) => make("option", { value: String(seconds) }, text)));
  choice.value = choice.dataset.usual;
}

function onLayout(message) {
  layout = message;
  showWindows();
  layout.lanes.forEach((lane, i) => { lane.title = titleOf(lane, i); });
  document.title = `${layout.scenario}: bayesftc console`;
  $("scenario").textContent = layout.scenario;
  document.body.classList.toggle("only-shown", Boolean(layout.only_shown));
  document.body.classList.toggle("not-recorded", layout.recorded === false);
  $("recorded").hidden = !layout.only_shown;
  put($("recorded"), layout.recorded ? "The signals up to the last complete piece of the recording." : "The signals are not recorded: start the run with --record DIR to download them.");
  loop = new Loop($("loop"), layout);
  $("loop").hidden = $("h-loop").hidden = layout.has_loop === false; // a monitor only listens
  scenes = new Scenes($("scenes"), layout);
  strips.forEach((strip) => strip.remove());
  strips = layout.strips.map((plan) => new Strip($("strips"), plan, layout.lanes));
  extra = extra.filter((name) => layout.lanes[0].columns.includes(name));
  extra.forEach(addStrip);
  showChoices();
  showCards();
  showBranches();
  showDownloads();
  shownLog = "";
  enable(layout.operator);
  if (extra.length) act({ do: "show", columns: extra });
}

function addStrip(name) {
  const plan = { title: name, unit: layout.units[name] || "", series: [{ label: name, look: "extra", column: name }] };
  const strip = new Strip($("strips"), plan, layout.lanes.map((l, i) => ({ ...l })).slice(0, 1));
  const close = make("button", { type: "button", "aria-label": `Remove ${name}` }, "remove");
  close.onclick = () => {
    extra = extra.filter((each) => each !== name);
    strips = strips.filter((each) => each !== strip);
    strip.remove();
    showChoices();
  };
  strip.element.querySelector("h3").append(" ", close);
  strips.push(strip);
}

function showDownloads() {
  const own = layout.lanes.filter((lane) => lane.branch === layout.lanes[0].branch), chosen = $("lane").value || "0";
  $("of-lane").hidden = own.length < 2;
  $("lane").replaceChildren(...own.map((lane, i) => make("option", { value: String(i) }, lane.name)));
  $("lane").value = Number(chosen) < own.length ? chosen : "0";
  $("lane").onchange = () => document.querySelectorAll(".links a").forEach((link) => {
    const path = new URL(link.href).pathname;
    link.setAttribute("href", $("lane").value === "0" ? path : `${path}?lane=${$("lane").value}`);
  });
  $("lane").onchange();
}

function showChoices() {
  const used = new Set([...extra, ...layout.strips.flatMap((s) => s.series.map((e) => e.column))]);
  $("more").replaceChildren(make("option", { value: "" }, "a signal"),
    ...layout.lanes[0].columns.filter((name) => !used.has(name)).map((name) => make("option", { value: name }, name)));
}

function enable(on) {
  const may = on && layout && layout.operator;
  document.querySelectorAll("#run, #step, #pace, #moment, #cards button, #cards input, #cards select, #settings button, #settings input, #branch-list button, #wire-list button, #wire-list input")
    .forEach((each) => { each.disabled = !may; });
  if (!layout) return;
  if (layout.only_shown && !layout.drops) {
    if (socket.readyState === WebSocket.OPEN) $("status").textContent = "A live run: faults are shown, not made.";
    return;
  }
  $("status").textContent = may ? "You have the controls." : on || !layout.free ? "You are watching. Another page has the controls." : "You are watching.";
  if (!may && socket.readyState === WebSocket.OPEN) {
    const claim = make("button", { type: "button" }, "take the controls");
    claim.onclick = async () => { if (await act({ do: "claim" })) say(""); };
    $("status").append(" ", claim);
  }
}

// --- Cards and the forms of faults ------------------------------------------------------------------------------

function showCards() {
  const open = new Set([...cards.values()].filter((c) => !c.form.hidden).map((c) => c.device.id));
  cards = new Map();
  $("cards").replaceChildren(...layout.devices.map((device) => card(device, open.has(device.id))));
}

function card(device, isOpen) {
  const p = make("span", { class: "p" }), bar = make("div"), words = make("p", { class: "words" });
  const details = make("dl"), list = make("ul", { class: "faults" }), ends = [];
  const toggle = make("button", { type: "button", "aria-expanded": String(isOpen) }, `Break ${device.name}`);
  const form = layout.only_shown ? make("form") : breakForm(device);
  form.hidden = !isOpen;
  form.id = `form-${device.id.replace(":", "-")}`;
  toggle.setAttribute("aria-controls", form.id);
  toggle.onclick = () => { form.hidden = !form.hidden; toggle.setAttribute("aria-expanded", String(!form.hidden)); };
  for (const fault of layout.faults.filter((f) => f.target === device.target && (f.sensor || 0) === device.channel)) {
    const end = make("button", { type: "button", "aria-label": `End ${fault.name}` }, "end");
    end.onclick = () => act({ do: "repair", name: fault.name });
    ends.push([end, fault.stop]);
    list.append(make("li", {}, make("span", {}, `${spaced(fault.kind)} ${fault.words}`), end));
  }
  const title = make("h3", {}, make("span", {}, device.of ? `${device.name} (${device.of})` : device.name), p);
  const element = make("article", { class: "card", "aria-label": device.name }, title, make("div", { class: "bars", "aria-hidden": "true" }, bar), words, details, list, toggle, form);
  cards.set(device.id, { device, element, p, bar, words, details, ends, form });
  return element;
}

const spaced = (kind) => kind.replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase();

function unitOf(text, unit) {
  if (!text.includes("{u}")) return text;
  if (text === "{u}/s" && unit.endsWith("/s")) return `${unit}²`;
  return unit ? text.replace("{u}", unit) : text.replace("{u}", "").replace(/^\/s$/, "per s");
}

function field(id, label, setting, range, value) {
  const slider = make("input", { type: "range", min: String(range[0]), max: String(range[1]), step: "any", value: String(value), "aria-label": `${label}, slider` });
  const box = make("input", { type: "number", id, step: "any", value: String(value), name: setting });
  slider.oninput = () => { box.value = String(Number(Number(slider.value).toPrecision(3))); };
  box.oninput = () => { slider.value = box.value; };
  return make("div", { class: "row" }, make("label", { for: id }, label), slider, box);
}

// The range of a slider and its first value, from the unit of the setting and the usual size of this device's faults.
function rangeOf(setting, device) {
  const scale = device.scale || Math.max(...recent(device).map(Math.abs), 1), level = recent(device).slice(-1)[0] || 0;
  const known = { factor: [0, 2, 0.5], probability: [0, 1, setting.default ?? 0.1], time_constant: [0, 5, 1], delay: [0, 5, 0.5],
    std: [0, 2 * scale, scale], magnitude: [-2 * scale, 2 * scale, scale], amplitude: [0, 2 * scale, 0], slope: [-scale, scale, 0.2 * scale],
    at: [level - 2 * scale, level + 2 * scale, level], low: [level - 2 * scale, level + 2 * scale, level - scale],
    high: [level - 2 * scale, level + 2 * scale, level + 0.2 * scale], resolution: [0, 2 * scale, 0.5 * scale], period: [0.1, 20, 1], phase: [0, 6.28, 0] };
  const [a, b, first] = known[setting.name] || [-2 * scale, 2 * scale, setting.default ?? scale];
  return [[tidy(a), tidy(b)], tidy(setting.name === "slope" && device.id.startsWith("sensor") ? Math.abs(first) : first)];
}

const tidy = (x) => Number(Number(x).toPrecision(3));

function recent(device) {
  const v = buffer && device.column ? buffer.column(0, device.column) : null;
  return v ? Array.from(v.subarray(Math.max(buffer.count - 500, 0), buffer.count)).filter(Number.isFinite) : [];
}

function breakForm(device) {
  const base = device.id.replace(":", "-"), form = make("form", { class: "break", "aria-label": `Break ${device.name}` });
  const kind = make("select", { id: `kind-${base}` }, ...device.kinds.map((k) => make("option", { value: k }, spaced(k))));
  const text = make("p"), fields = make("div"), remembered = memory.forms.get(device.id);
  if (remembered) kind.value = remembered.kind;
  const show = () => {
    const plan = layout.kinds.find((k) => k.kind === kind.value);
    const before = memory.forms.get(device.id), values = before && before.kind === kind.value ? before.values : {};
    memory.forms.set(device.id, { kind: kind.value, values });
    text.textContent = plan.words.replace(/``?([^`]*)``?/g, "$1");
    fields.replaceChildren(...plan.settings.filter((s) => s.type === "number" && s.name !== "initial").map((s) => {
      const [range, usual] = rangeOf(s, device), first = values[s.name] ?? usual, unit = unitOf(s.unit, device.unit);
      return field(`${base}-${s.name}`, `${s.name.replaceAll("_", " ")}${unit ? ` in ${unit}` : ""}`, s.name, range, first);
    }));
  };
  kind.onchange = show;
  const duration = field(`${base}-duration`, "duration in s (0: until it is ended)", "duration", [0, 20], 0);
  const when = make("select", { id: `${base}-when` }, make("option", { value: "now" }, "now"), make("option", { value: "time" }, "at a time"), make("option", { value: "condition" }, "on a condition"));
  const start = make("input", { type: "text", id: `${base}-start`, autocomplete: "off" }), startLabel = make("label", { for: start.id });
  const startRow = make("div", { hidden: true }, startLabel, start);
  when.onchange = () => {
    startRow.hidden = when.value === "now";
    startLabel.textContent = when.value === "time" ? "time in s" : "condition, such as plant.v > 22";
    start.value = when.value === "time" && state ? String(Math.ceil(state.t + 2)) : "";
  };
  const inject = make("button", { type: "submit", class: "main" }, "Inject");
  form.append(make("div", {}, make("label", { for: kind.id }, "fault"), kind), text, fields, duration, make("div", {}, make("label", { for: when.id }, "when"), when), startRow, inject);
  form.onsubmit = async (event) => {
    event.preventDefault();
    const settings = { kind: kind.value, sensor: device.channel };
    for (const box of fields.querySelectorAll("input[type=number]")) if (box.value !== "") settings[box.name] = Number(box.value);
    const seconds = Number(duration.querySelector("input[type=number]").value);
    if (seconds > 0) settings.duration = seconds;
    if (when.value === "time") settings.start = Number(start.value);
    if (when.value === "condition") settings.start = start.value;
    memory.forms.set(device.id, { kind: kind.value, values: settings });
    inject.disabled = true;
    await act({ do: "fault", target: device.target, settings });
    inject.disabled = false;
  };
  show();
  return form;
}

function updateCards() {
  for (const each of state.cards) {
    const card = cards.get(each.id);
    if (!card) continue;
    card.element.className = `card ${each.state}`;
    put(card.p, each.p === null ? "" : `P(fault) ${each.p >= 0.9995 ? ">.999" : each.p.toFixed(3).replace(/^0/, "")}`);
    card.bar.style.width = `${100 * (each.p || 0)}%`;
    put(card.words, each.words);
    for (const [end, stop] of card.ends) end.hidden = stop !== null && stop <= state.t;
    const rows = [];
    if (each.kind) rows.push(["kind", each.kind]);
    if (each.size) rows.push(["size", each.size]);
    if (each.since !== null) rows.push(["since", `${each.since.toFixed(2)} s`]);
    if (!layout.only_shown) rows.push(["in truth", each.present.length ? `${each.present.join(", ")} is present` : "no fault"]);
    const text = JSON.stringify(rows);
    if (card.said !== text) {
      card.said = text;
      card.details.replaceChildren(...rows.flatMap(([a, b]) => [make("dt", {}, a), make("dd", {}, b)]));
    }
  }
}

// --- Reference, inputs, branches ---------------------------------------------------------------------------------

const typed = new Map(); // values that the operator has entered and not yet set; the other settings show the present value

function showSettings() {
  const rows = [...layout.goals.map((g) => ["goal", g.target, `reference of ${g.name}`, g.unit, g.column]), ...layout.inputs.map((i) => ["input", i.name, `${i.parameter ? "parameter" : "input"} ${i.name}`, layout.units[`plant.${i.name}`] || "", null, i.value])];
  $("settings").replaceChildren(...rows.map(([what, target, title, unit, column, known]) => {
    const id = `set-${what}-${target}`, level = column && buffer ? buffer.last(0, column) : known ?? 0;
    const value = tidy(Number.isFinite(level) ? level : 0), reach = Math.abs(value) || 1;
    const row = field(id, `${title}${unit ? ` in ${unit}` : ""}`, target, [tidy(value - 1.5 * reach), tidy(value + 1.5 * reach)], typed.get(id) ?? value);
    const set = make("button", { type: "button", "aria-label": `Set ${title}` }, "Set");
    row.className = "setting";
    row.append(set);
    set.onclick = async () => {
      const entered = Number($(id).value);
      if (await act({ do: what, target, value: entered }) && Number($(id).value) === entered) typed.delete(id);
    };
    row.addEventListener("input", () => typed.set(id, $(id).value));
    set.disabled = !layout.operator;
    row.querySelectorAll("input").forEach((each) => { each.disabled = !layout.operator; });
    if (column) row.dataset.column = column;
    return row;
  }));
}

function updateSettings() {
  for (const row of document.querySelectorAll("#settings [data-column]")) {
    const [slider, box] = row.querySelectorAll("input"), value = tidy(buffer.last(0, row.dataset.column));
    if (typed.has(box.id) || !Number.isFinite(value) || Number(box.value) === value) continue;
    slider.min = Math.min(slider.min, value);
    slider.max = Math.max(slider.max, value);
    slider.value = box.value = value;
  }
}

const reach = (branch, end) => `${branch.parent === null ? "" : `from ${branch.parent} at ${branch.since.toFixed(2)} s, `}to ${end.toFixed(2)} s`;

function showBranches() {
  $("branch-list").replaceChildren(...layout.branches.map((branch) => {
    const names = make("div", { class: "names" }, make("strong", {}, branch.name), make("small", branch.active ? { id: "reach" } : {}, reach(branch, branch.furthest)));
    const buttons = make("div", { class: "buttons" });
    const button = (text, label, command) => {
      const made = make("button", { type: "button", "aria-label": `${label} ${branch.name}` }, text);
      made.onclick = () => act(typeof command === "function" ? command() : command);
      buttons.append(made);
    };
    if (branch.active) buttons.append(make("span", {}, "shown now"));
    else {
      button("show", "Show", { do: "choose", name: branch.name });
      button(branch.compared ? "end comparison" : "compare", branch.compared ? "End comparison with" : "Compare with", { do: "compare", name: branch.compared ? null : branch.name });
      button("remove", "Remove", { do: "remove", name: branch.name });
    }
    const rename = make("button", { type: "button", "aria-label": `Rename ${branch.name}` }, "rename");
    rename.onclick = () => {
      const box = make("input", { type: "text", maxlength: "40", value: branch.name, "aria-label": `New name of ${branch.name}` });
      names.firstChild.replaceWith(box);
      box.focus();
      box.select();
      box.onkeydown = (event) => {
        if (event.key === "Enter") act({ do: "rename", name: branch.name, new: box.value });
        if (event.key === "Escape" || event.key === "Enter") showBranches();
      };
    };
    buttons.append(rename);
    return make("li", {}, names, buttons);
  }));
}

// --- Time, log -------------------------------------------------------------------------------------------------------

function updateTime() {
  const active = layout.branches.find((branch) => branch.active);
  if (active) put($("reach"), reach(active, state.furthest * layout.step));
  put($("clock"), `${state.t.toFixed(2)} s`);
  put($("run"), state.running ? "Pause" : "Run");
  const pace = state.pace === null ? "" : String(state.pace);
  if (document.activeElement !== $("pace") && $("pace").value !== pace) $("pace").value = pace;
  const moment = $("moment");
  moment.max = String(state.furthest);
  if (!dragging) { moment.value = String(state.k); put($("chosen"), `${state.t.toFixed(2)} s`); }
  moment.setAttribute("aria-valuetext", `${(Number(moment.value) * layout.step).toFixed(2)} seconds`);
  if (state.busy) $("status").textContent = `${state.busy[0]}: ${Math.round(100 * state.busy[1])} %`;
  else if ($("status").textContent.startsWith("recomputing")) enable(true);
}

function updateLog() {
  const words = { true: "alarm", false: "alarm ends" };
  const events = [...layout.actions.map((a) => [a.t, `by hand: ${a.words}`, a.later ? "later" : "hand"]),
    ...state.actions.map((a) => [a.t, `by hand: ${a.words}`, "hand"]),
    ...state.alarms.map((a) => [a.t, `${(layout.devices.find((d) => d.id === `${a.device}:${a.number}`) || { name: `${a.device} ${a.number}` }).name}: ${words[a.begins]}`, a.begins ? "alarm" : "end"])]
    .sort((a, b) => a[0] - b[0]).slice(-200);
  const text = JSON.stringify(events) + state.furthest;
  if (text === shownLog) return;
  const isNew = JSON.stringify(events) !== shownLog.slice(0, -String(state.furthest).length);
  shownLog = text;
  const end = Math.max(state.furthest * layout.step, layout.step);
  $("marks").setAttribute("viewBox", "0 0 1000 10");
  const colours = { hand: "var(--accent)", later: "var(--accent)", alarm: "var(--bad)", end: "var(--good)" };
  $("marks").replaceChildren(...events.map(([t, , kind]) => {
    const mark = document.createElementNS("http://www.w3.org/2000/svg", "rect");
    for (const [key, value] of Object.entries({ x: 1000 * t / end - 1.5, y: colours[kind] === colours.hand ? 0 : 3, width: 3, height: colours[kind] === colours.hand ? 10 : 7 })) mark.setAttribute(key, value);
    mark.style.fill = colours[kind];
    return mark;
  }));
  if (!isNew) return;
  const list = $("log"), below = list.scrollHeight - list.scrollTop - list.clientHeight < 30;
  list.replaceChildren(...events.filter((e) => e[2] !== "later").map(([t, sentence]) => make("li", {}, make("time", {}, `${t.toFixed(2)} s`), " ", sentence)));
  if (below) list.scrollTop = list.scrollHeight;
}

function draw() {
  requestAnimationFrame(draw);
  if (!dirty || !state || !layout || !buffer) return;
  dirty = false;
  updateTime();
  updateCards();
  updateSettings();
  updateLog();
  wires.show(state.wires, layout);
  loop.show(buffer, state.cards);
  scenes.show(state.scenes, buffer, state.stopped);
  const seconds = Number($("window").value);
  const begin = seconds ? Math.max(state.t - seconds, 0) : buffer.t[0] || 0;
  const end = seconds ? Math.max(state.t, begin + seconds) : state.t;
  strips.forEach((strip) => strip.show(buffer, begin, end));
  const problem = state.stopped.find((each) => each);
  if (problem && $("message").hidden) say(problem);
}

$("run").onclick = () => act({ do: "run", on: !(state && state.running) });
$("step").onclick = () => act({ do: "step" });
$("pace").onchange = () => act({ do: "pace", pace: $("pace").value === "" ? null : Number($("pace").value) });
$("moment").oninput = () => { dragging = true; put($("chosen"), `${(Number($("moment").value) * layout.step).toFixed(2)} s`); };
$("moment").onchange = async () => { await act({ do: "back", k: Number($("moment").value) }); dragging = false; };
$("window").onchange = () => { dirty = true; };
$("more").onchange = async () => {
  const name = $("more").value;
  if (!name || extra.length >= 12) return;
  extra.push(name);
  addStrip(name);
  showChoices();
  await act({ do: "show", columns: extra });
};
document.addEventListener("keydown", (event) => {
  if (event.target.closest("input, select, button, a, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " ") { event.preventDefault(); $("run").click(); }
  if (event.key === "s") $("step").click();
});
addEventListener("resize", () => { dirty = true; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { strips.forEach((strip) => strip.build()); dirty = true; });
connect();
requestAnimationFrame(draw);
