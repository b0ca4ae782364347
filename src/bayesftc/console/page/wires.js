// The wires of a live run: connections, and the numbers of messages and missing samples.
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
  constructor(section, list) { this.section = section; this.list = list; this.rows = new Map(); }

  show(wires) {
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
    }
  }

  row(wire) {
    const state = make("span"), count = make("small", { class: "numbers" }), problem = make("small", { class: "bad" });
    const name = make("span", {}, `${wire.name}: ${wire.is_input ? "to" : "from"} ${wire.signals}`);
    return { element: make("li", {}, name, state, count, problem), state, numbers: count, problem };
  }
}
