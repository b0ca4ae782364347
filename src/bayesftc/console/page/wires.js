// The wires of a live run: connections, the numbers of messages and missing samples, and samples that are dropped by hand.
import { make, put } from "/page/elements.js";

const percent = (share) => `${(100 * share).toFixed(1)} %`;
const counts = (of) => Object.entries(of).map(([reason, count]) => `${reason} ${count}`).join(", ");

function numbers(wire) {
  if ("received" in wire) {
    const missing = counts(wire.missing);
    return `${wire.received} messages, ${percent(wire.missing_share)} of the samples missing${missing ? `: ${missing}` : ""}`;
  }
  if ("sent" in wire) return `${wire.sent} sent, ${wire.lost} lost, ${wire.safe} safe values`;
  return "";
}

export class Wires {
  constructor(section, list, act) { Object.assign(this, { section, list, act, rows: new Map() }); }

  show(wires, layout) {
    this.layout = layout;
    this.section.hidden = !wires.length;
    if (wires.length !== this.rows.size || wires.some((wire) => !this.rows.has(wire.name))) {
      this.rows = new Map(wires.map((wire) => [wire.name, this.row(wire)]));
      this.list.replaceChildren(...[...this.rows.values()].map((row) => row.element));
    }
    for (const wire of wires) {
      const row = this.rows.get(wire.name);
      put(row.state, wire.connected ? "connected" : "not connected");
      row.state.className = wire.connected ? "ok" : "bad";
      put(row.numbers, numbers(wire));
      put(row.problem, wire.problem);
      row.problem.hidden = !wire.problem;
      put(row.dropping, wire.dropping ? `Samples are dropped by hand for ${wire.dropping.toFixed(1)} s more.` : "");
      row.dropping.hidden = !wire.dropping;
    }
  }

  row(wire) {
    const state = make("span"), count = make("small", { class: "numbers" }), problem = make("small", { class: "bad" });
    const name = make("span", {}, `${wire.name}: ${wire.is_input ? "to" : "from"} ${wire.signals}`);
    const dropping = make("small", { class: "bad" });
    const element = make("li", {}, name, state, count, problem, dropping);
    if (this.layout.drops && wire.is_input) element.append(this.form(wire.name));
    return { element, state, numbers: count, problem, dropping };
  }

  form(wire) {
    const seconds = make("input", { type: "number", min: "0", max: "3600", step: "any", value: "1", required: "" });
    const drop = make("button", { type: "submit", "aria-label": `Drop samples of ${wire}` }, "drop samples");
    const form = make("form", { class: "drop" }, drop, make("label", {}, "for ", seconds, " s"));
    for (const each of [seconds, drop]) each.disabled = !this.layout.operator;
    seconds.setAttribute("aria-label", `Seconds for which samples of ${wire} are dropped`);
    form.onsubmit = (event) => {
      event.preventDefault();
      this.act({ do: "drop", wire, seconds: Number(seconds.value) });
    };
    return form;
  }
}
