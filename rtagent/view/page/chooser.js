// The list of what can be plotted, and what of it is chosen; the choice is kept for the next time.

const AT_FIRST = { signals: 3, demons: 2 };
const MOST = 24; // that can be chosen at a time: with returns 48 series, which is as many as the server sends
const LISTED = 300; // demons that are listed before the filter has to say which

export class Chooser {
  constructor(place, filter, { onChange, onFull }) {
    this.place = place;
    this.filter = filter;
    this.onChange = onChange;
    this.onFull = onFull;
    this.chosen = new Set();
    this.about = null;
    filter.addEventListener("input", () => this.#list());
  }

  show(run, about) {
    const kept = `rtagent ${run.split("/")[0]}`;
    if (kept !== this.kept || !this.chosen.size) {
      this.kept = kept;
      this.chosen = new Set((stored(kept) ?? []).slice(0, MOST));
    }
    const grown = JSON.stringify([about.signals, about.demons, about.components]);
    if (grown !== this.grown) {
      this.grown = grown;
      this.about = about;
      if (!stored(kept)) this.chosen = new Set(usual(about));
      this.#list();
    }
  }

  #list() {
    if (!this.about) return;
    const groups = new Map();
    for (const choice of choices(this.about)) {
      if (!fits(choice.label, this.filter.value)) continue;
      if (!groups.has(choice.group)) groups.set(choice.group, []);
      groups.get(choice.group).push(choice);
    }
    this.place.replaceChildren(...[...groups].map(([group, listed]) => this.#group(group, listed)));
  }

  #group(group, listed) {
    const set = document.createElement("fieldset");
    set.append(Object.assign(document.createElement("legend"), { textContent: group }));
    set.append(...listed.slice(0, LISTED).map((choice) => this.#choice(choice)));
    if (listed.length > LISTED) {
      const more = `${listed.length - LISTED} more: filter them`;
      set.append(Object.assign(document.createElement("p"), { className: "note", textContent: more }));
    }
    return set;
  }

  #choice({ key, label, unit }) {
    const row = Object.assign(document.createElement("label"), { className: "choice" });
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: this.chosen.has(key), name: key });
    box.addEventListener("change", () => {
      if (box.checked && this.chosen.size >= MOST) {
        box.checked = false;
        this.onFull(`${MOST} can be shown at a time: choose another one away first.`);
        return;
      }
      if (box.checked) this.chosen.add(key); else this.chosen.delete(key);
      store(this.kept, [...this.chosen]);
      this.onChange();
    });
    row.append(box, breakable(label));
    if (unit) row.append(Object.assign(document.createElement("small"), { textContent: unit }));
    return row;
  }
}

function breakable(label) {
  const text = document.createElement("span");
  label.split(/(?<=[_.])/).forEach((part) => text.append(part, document.createElement("wbr")));
  return text;
}

// The signals, those of devices first.
export function sorted(signals) {
  return [...signals].sort((a, b) => (a.group === "agent") - (b.group === "agent"));
}

function choices(about) {
  return [
    ...sorted(about.signals).map(({ key, group, column, unit }) => ({ key, group, label: column, unit })),
    ...(about.demons ?? []).map(({ name }, place) => ({ key: `prediction/${place}`, group: "predictions", label: name })),
    ...about.components.map((name) => ({ key: `components/${name}`, group: "component times", label: name })),
  ];
}

function usual(about) {
  const sensed = about.signals.filter(({ group }) => group !== "agent").slice(0, AT_FIRST.signals);
  const reward = about.signals.filter(({ column, group }) => group === "agent" && column === "reward");
  const demons = (about.demons ?? []).slice(0, AT_FIRST.demons).map((_, place) => `prediction/${place}`);
  return [...sensed, ...reward].map(({ key }) => key).concat(demons, about.components.map((name) => `components/${name}`));
}

const fits = (label, words) => words.toLowerCase().split(/\s+/).every((word) => label.toLowerCase().includes(word));

function stored(name) {
  try { return JSON.parse(localStorage.getItem(name)); } catch { return null; }
}

function store(name, value) {
  try { localStorage.setItem(name, JSON.stringify(value)); } catch { /* a browser that keeps nothing */ }
}
