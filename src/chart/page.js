"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const by = (id) => document.getElementById(id);
  const DOT = " \u00b7 ";
  const NONE = "\u2013";
  const hidden = new Set();
  let sorting = { column: 3, up: true };
  let entries = [];

  // Numbers as a reader wants them.
  const grouped = (v) => Math.round(v).toString().replace(/\B(?=(\d{3})+$)/g, ",");
  const trimmed = (text) => (text.includes(".") ? text.replace(/0+$/, "").replace(/\.$/, "") : text);
  function short(v) {
    if (v === null || v === undefined || !Number.isFinite(v)) return NONE;
    if (v === 0) return "0";
    const [mantissa, exponent] = v.toExponential(3).split("e");
    const e = Number(exponent);
    if (e < -3 || e >= 6) return trimmed(mantissa) + "e" + e;
    return e >= 3 ? grouped(v) : trimmed(v.toFixed(3 - e));
  }
  function size(v) {
    if (v === null || v === undefined || !Number.isFinite(v)) return NONE;
    if (v < 1e3) return short(v) + " B";
    if (v < 1e6) return short(v / 1e3) + " kB";
    return v < 1e9 ? short(v / 1e6) + " MB" : short(v / 1e9) + " GB";
  }

  // Elements; texts are only ever set as text.
  function element(name, attributes = {}, text) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }
  function drawn(name, attributes = {}, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }
  function offer(id, options, chosen) {
    const select = by(id);
    const before = chosen ?? select.value;
    select.replaceChildren(...options.map(([value, text]) => element("option", { value }, text)));
    const keep = options.some(([value]) => value === before);
    select.value = keep ? before : options.length ? options[0][0] : "";
  }
  const outline = (family, x, y, r) =>
    "M" + family.outline.map(([dx, dy]) => `${(x + r * dx).toFixed(2)} ${(y + r * dy).toFixed(2)}`).join("L") + "Z";
  const colour = (family) => family.colour ?? "var(--ink)";

  // What can be chosen.
  const levelText = (level) => (level === null ? "all" : String(level));
  const unique = (values) => [...new Set(values)];
  function offerLevels(chosen) {
    const levels = unique(data.groups.filter((g) => g.split === by("split").value).map((g) => g.level));
    levels.sort((a, b) => (a ?? -1) - (b ?? -1));
    offer("level", levels.map((l) => [levelText(l), levelText(l)]), chosen);
  }
  function offerMaterials(chosen) {
    const materials = data.materials.map((name, i) => [String(i), name]);
    const mean = data.groups.some((g) => g.material === null);
    if (mean) materials.unshift(["mean", metric().mean]);
    offer("material", materials, chosen);
  }
  const metric = () => data.metrics.find((m) => m.name === by("metric").value);
  const cost = () => data.costs.find((c) => c.key === by("cost").value);

  // Groups to entries: a variant with its spreads.
  function spread(values, log) {
    const shown = (values ?? []).filter((v) => v !== null && Number.isFinite(v) && (!log || v > 0));
    if (!shown.length) return null;
    const low = Math.min(...shown);
    const high = Math.max(...shown);
    const mean = shown.reduce((sum, v) => sum + v, 0) / shown.length;
    return { mean: Math.min(Math.max(mean, low), high), low, high, n: shown.length };
  }
  function label(group, all) {
    const v = data.variants[group.variant];
    const alike = all.map((g) => data.variants[g.variant]).filter((o) => o.preset === v.preset);
    let text = v.preset;
    if (alike.some((o) => o.regime !== v.regime)) text += DOT + v.regime;
    if (alike.some((o) => String(o.resolution) !== String(v.resolution)))
      text += DOT + v.resolution.join(" \u00d7 ");
    if (alike.some((o) => o.budget !== v.budget)) text += DOT + grouped(v.budget) + "/texel";
    return text;
  }
  function select() {
    const material = by("material").value;
    const regime = by("regime").value;
    const asked = (g) =>
      g.split === by("split").value &&
      levelText(g.level) === by("level").value &&
      (regime === "" || "=" + data.variants[g.variant].regime === regime);
    const all = data.groups.filter(
      (g) => (g.material === null ? "mean" : String(g.material)) === material && asked(g)
    );
    const { name, higher } = metric();
    const reasons = new Map();
    const out = [];
    for (const group of all) {
      const x = spread(group.values[cost().key], true);
      const y = spread(group.values[name], !higher);
      const variant = data.variants[group.variant];
      const entry = { group, variant, label: label(group, all), family: data.families[variant.family], x, y };
      entry.seeds = group.seeds.length;
      out.push(entry);
      const count = (why, n = 1) => reasons.set(why, (reasons.get(why) ?? 0) + n);
      if (!x || !y) {
        const key = !y ? name : cost().key;
        count(group.values[key] ? `with ${key} of 0 or less` : `without ${key}`);
      } else if (Math.min(x.n, y.n) < entry.seeds) {
        count("single seeds without a value", entry.seeds - Math.min(x.n, y.n));
      }
    }
    if (material === "mean") {
      const anywhere = new Set(data.groups.filter((g) => asked(g)).map((g) => g.variant));
      const lost = anywhere.size - new Set(all.map((g) => g.variant)).size;
      if (lost > 0) reasons.set("not on every material with the same seeds", lost);
    }
    const words = [...reasons].map(([why, n]) => `${n} ${why}`);
    by("left-out").textContent = words.length ? "Not in the chart: " + words.join(", ") + "." : "";
    return out;
  }
  function markFront(shown) {
    const worse = metric().higher ? -1 : 1;
    for (const e of shown) {
      e.front = !shown.some((o) => {
        const [dx, dy] = [o.x.mean - e.x.mean, worse * (o.y.mean - e.y.mean)];
        return dx <= 0 && dy <= 0 && (dx < 0 || dy < 0);
      });
    }
  }

  // Axes.
  function axis(values, log, from, to) {
    let low = Math.min(...values);
    let high = Math.max(...values);
    if (log) {
      const margin = Math.sqrt(Math.max(2 / (high / low), 1)) * Math.max((high / low) ** 0.07, 1.08);
      [low, high] = [low / margin, high * margin];
    } else {
      const margin = Math.max(0.07 * (high - low), 1e-3 * Math.abs(high), 1e-6);
      [low, high] = [low - margin, high + margin];
    }
    const part = (v) => (log ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low));
    const place = (v) => from + part(v) * (to - from);
    return { place, ticks: log ? logTicks(low, high) : linearTicks(low, high) };
  }
  function logTicks(low, high) {
    const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const step = Math.max(1, Math.floor((last - first + 1) / 8));
    const of = (mantissas) => {
      const ticks = [];
      for (let d = first; d <= last; d += step) for (const m of mantissas) ticks.push(Number(m + "e" + d));
      return ticks.filter((v) => v >= low && v <= high);
    };
    for (const division of [[1], [1, 2, 5], [1, 1.5, 2, 3, 4, 5, 7]]) {
      const ticks = of(division);
      if (ticks.length >= 4) return ticks;
    }
    return of([1, 1.2, 1.5, 1.7, 2, 2.5, 3, 3.5, 4, 5, 6, 7, 8, 9]);
  }
  function linearTicks(low, high) {
    const rough = (high - low) / 6;
    const e = Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((m) => Number(m + "e" + e)).find((s) => s >= rough) ?? rough;
    const ticks = [];
    for (let k = Math.ceil(low / step); k * step <= high && ticks.length < 20; k++) ticks.push(k * step);
    return ticks;
  }

  // Names beside marks: each takes the cheapest place around its mark, in turn.
  const overlap = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
  function crosses([start, end], box) {
    let [from, to] = [0, 1];
    for (let k = 0; k < 2; k++) {
      const way = end[k] - start[k];
      const [low, high] = [box[k] - start[k], box[k + 2] - start[k]];
      if (way === 0) {
        if (low > 0 || high < 0) return false;
      } else {
        from = Math.max(from, Math.min(low / way, high / way));
        to = Math.min(to, Math.max(low / way, high / way));
      }
    }
    return from < to;
  }
  function placeNames(wanted, marks, lines, frame, towards) {
    const taken = [];
    for (const name of wanted) {
      let best = null;
      for (const distance of [10, 17, 27, 42, 60, 82]) {
        for (let k = 0; k < 16; k++) {
          const angle = (k * Math.PI) / 8;
          const [dx, dy] = [Math.cos(angle), Math.sin(angle)];
          const [x, y] = [name.at[0] + dx * distance, name.at[1] + dy * distance];
          const beyond = (way) => (1 - Math.min(Math.max(1.6 * way, -1), 1)) / 2;
          const left = x - name.width * beyond(dx);
          const top = y - name.height * beyond(dy);
          const box = [left, top, left + name.width, top + name.height];
          const leader = distance > 14 ? [[name.at[0] + dx * 5, name.at[1] + dy * 5], [x, y]] : null;
          if (box[0] < frame[0] || box[1] < frame[1] || box[2] > frame[2] || box[3] > frame[3]) continue;
          if (taken.some((t) => overlap(box, t.box))) continue;
          let price = 0.45 * distance + 5 * (1 - Math.cos(angle - towards));
          for (const m of marks) {
            const around = [m[0] - 7, m[1] - 7, m[0] + 7, m[1] + 7];
            if (overlap(box, around)) price += 60;
            if (leader && m !== name.at && crosses(leader, around)) price += 25;
          }
          price += 9 * lines.filter((line) => crosses(line, box)).length;
          for (const t of taken)
            if ((leader && crosses(leader, t.box)) || (t.leader && crosses(t.leader, box))) price += 25;
          if (price < 75 && (!best || price < best.price)) best = { price, box, leader, name };
        }
      }
      if (best) taken.push(best);
    }
    return taken;
  }
  const measure = document.createElement("canvas").getContext("2d");
  function textWidth(text) {
    measure.font = "13px " + getComputedStyle(document.body).fontFamily;
    return measure.measureText(text).width;
  }
  const cut = (text, most) => (text.length <= most ? text : text.slice(0, most - 1) + "\u2026");

  // The chart.
  function draw() {
    const svg = by("chart");
    const width = Math.max(320, by("stage").clientWidth);
    const height = Math.round(Math.min(Math.max(360, width * 0.5), 600));
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("height", height);
    svg.replaceChildren();
    const shown = entries.filter((e) => e.x && e.y && !hidden.has(e.family.name));
    const [left, top, right, bottom] = [72, 10, width - 10, height - 54];
    for (const e of entries) e.node = null;
    if (!shown.length) {
      const at = { x: (left + right) / 2, y: (top + bottom) / 2, "text-anchor": "middle" };
      svg.append(drawn("text", at, "nothing to show"));
      return;
    }
    const { name, higher } = metric();
    const x = axis(shown.flatMap((e) => [e.x.low, e.x.high]), true, left, right);
    const y = axis(shown.flatMap((e) => [e.y.low, e.y.high]), !higher, bottom, top);
    const line = (a, b, attributes) => drawn("line", { x1: a[0], y1: a[1], x2: b[0], y2: b[1], ...attributes });
    let last = -Infinity;
    for (const tick of x.ticks) {
      const at = x.place(tick);
      const text = cost().bytes ? size(tick) : short(tick);
      svg.append(line([at, top], [at, bottom], { class: "grid" }));
      const half = textWidth(text) / 2;
      if (at - half < last + 6) continue;
      last = at + half;
      svg.append(drawn("text", { x: at, y: bottom + 18, "text-anchor": "middle", class: "tick" }, text));
    }
    for (const tick of y.ticks) {
      const at = y.place(tick);
      svg.append(line([left, at], [right, at], { class: "grid" }));
      svg.append(drawn("text", { x: left - 8, y: at + 4, "text-anchor": "end", class: "tick" }, short(tick)));
    }
    svg.append(line([left, bottom], [right, bottom], { class: "axis" }));
    svg.append(line([left, top], [left, bottom], { class: "axis" }));
    const middle = [(left + right) / 2, (top + bottom) / 2];
    svg.append(drawn("text", { x: middle[0], y: bottom + 40, "text-anchor": "middle" }, cost().words));
    const turn = `translate(14 ${middle[1]}) rotate(-90)`;
    svg.append(drawn("text", { transform: turn, "text-anchor": "middle" }, name));
    const lines = [];
    for (const e of shown) {
      e.at = [x.place(e.x.mean), y.place(e.y.mean)];
      e.bars = [
        [[x.place(e.x.low), e.at[1]], [x.place(e.x.high), e.at[1]]],
        [[e.at[0], y.place(e.y.low)], [e.at[0], y.place(e.y.high)]],
      ].filter(([a, b]) => a[0] !== b[0] || a[1] !== b[1]);
      lines.push(...e.bars);
    }
    const steps = frontLine(shown, higher ? bottom : top, right);
    for (let k = 1; k < steps.length; k++) lines.push([steps[k - 1], steps[k]]);
    svg.append(drawn("path", { class: "front", d: "M" + steps.map((p) => p.join(" ")).join("L") }));
    const order = [...shown].sort((a, b) => a.front - b.front || a.x.mean - b.x.mean);
    for (const e of order) svg.append(mark(e));
    const names = by("names").value;
    const wanted = order.filter((e) => names === "all" || (names === "front" && e.front));
    wanted.sort((a, b) => b.front - a.front || a.x.mean - b.x.mean);
    const boxes = wanted.slice(0, 300).map((e) => {
      const text = cut(e.label, 40);
      return { at: e.at, width: textWidth(text) + 4, height: 15, text };
    });
    const towards = (higher ? 1.25 : 0.75) * Math.PI;
    const marks = shown.map((e) => e.at);
    for (const { box, leader, name: of } of placeNames(boxes, marks, lines, [left, top, right, bottom], towards)) {
      if (leader) svg.append(line(leader[0], leader[1], { class: "leader" }));
      const at = { x: (box[0] + box[2]) / 2, y: box[3] - 3.5, "text-anchor": "middle" };
      svg.append(drawn("text", { ...at, "pointer-events": "none", "aria-hidden": "true" }, of.text));
    }
  }
  function frontLine(shown, worst, right) {
    const members = shown.filter((e) => e.front).sort((a, b) => a.at[0] - b.at[0]);
    const points = [];
    let height = worst;
    for (const { at } of members) {
      points.push([at[0], height], [at[0], at[1]]);
      height = at[1];
    }
    points.push([right, height]);
    return points;
  }
  function mark(e) {
    const says = [e.label, ...facts(e).map(([key, value]) => `${key} ${value}`)].join(", ");
    const node = drawn("g", { class: "mark", tabindex: "0", role: "img", "aria-label": says });
    const d = outline(e.family, e.at[0], e.at[1], 5);
    node.append(drawn("path", { class: "rim", d }));
    for (const [a, b] of e.bars)
      node.append(drawn("path", { class: "bar", d: `M${a.join(" ")}L${b.join(" ")}`, stroke: colour(e.family) }));
    const filled = e.front || e.family.colour === null;
    const shape = { class: filled ? "shape" : "shape hollow", d, stroke: colour(e.family) };
    if (filled) shape.fill = colour(e.family);
    node.append(drawn("path", shape));
    for (const on of ["pointerenter", "focus"]) node.addEventListener(on, () => light(e, true));
    for (const off of ["pointerleave", "blur"]) node.addEventListener(off, () => light(e, false));
    e.node = node;
    return node;
  }

  // What is said of a mark.
  function ranged(s, show) {
    if (!s) return NONE;
    return s.low === s.high ? show(s.mean) : `${show(s.mean)} (${show(s.low)} to ${show(s.high)})`;
  }
  const show = (key) => (data.costs.some((c) => c.key === key && c.bytes) ? size : short);
  function facts(e) {
    const { group, variant } = e;
    const values = [...data.metrics.map((m) => m.name), ...data.costs.map((c) => c.key)];
    const rows = values
      .filter((key) => group.values[key])
      .map((key) => [key, ranged(spread(group.values[key], false), show(key))]);
    rows.push(["on the Pareto front", e.front ? "yes" : "no"]);
    rows.push(["seeds", `${group.seeds.length}: ${group.seeds.join(", ")}`]);
    rows.push(["texels", variant.resolution.join(" \u00d7 ")]);
    rows.push(["samples a texel", grouped(variant.budget)]);
    rows.push(["training directions", variant.regime]);
    if (group.engine) rows.push(["answered by", group.engine]);
    return rows;
  }
  function light(e, on) {
    e.node?.classList.toggle("lit", on);
    e.row?.classList.toggle("lit", on);
    const tip = by("tip");
    tip.hidden = !on || !e.node;
    if (tip.hidden) return;
    const table = element("table");
    for (const [key, value] of facts(e)) {
      const row = element("tr");
      row.append(element("th", { scope: "row" }, key), element("td", {}, value));
      table.append(row);
    }
    tip.replaceChildren(element("strong", {}, e.label), table);
    const stage = by("stage");
    const beside = e.at[0] + 16 + tip.offsetWidth <= stage.clientWidth;
    tip.style.left = Math.max(0, beside ? e.at[0] + 16 : e.at[0] - 16 - tip.offsetWidth) + "px";
    tip.style.top = Math.max(0, Math.min(e.at[1] - 20, stage.clientHeight - tip.offsetHeight)) + "px";
  }

  // The table.
  function columns() {
    const mean = (key) => (e) => spread(e.group.values[key], false);
    const errors = data.metrics.filter((m) => m.name !== metric().name && entries.some((e) => e.group.values[m.name]));
    return [
      { name: "variant", of: (e) => e.label },
      { name: "family", of: (e) => e.family.name },
      { name: "front", of: (e) => (e.front ? "yes" : "") },
      ...[metric(), ...errors].map((m) => ({ name: m.name, spread: mean(m.name), show: short })),
      ...data.costs.map((c) => ({ name: c.key, spread: mean(c.key), show: c.bytes ? size : short })),
      { name: "seeds", of: (e) => e.seeds, number: true },
      { name: "samples a texel", of: (e) => e.variant.budget, number: true, show: grouped },
      { name: "texels", of: (e) => e.variant.resolution.join(" \u00d7 ") },
      { name: "training directions", of: (e) => e.variant.regime },
    ];
  }
  const value = (column, e) => (column.spread ? (column.spread(e)?.mean ?? null) : column.of(e));
  function tabulate() {
    const all = columns();
    const by_column = all[Math.min(sorting.column, all.length - 1)];
    const rows = entries.filter((e) => !hidden.has(e.family.name));
    rows.sort((a, b) => {
      const [p, q] = [value(by_column, a), value(by_column, b)];
      // What has no number stands last, either way.
      if (p === null || q === null) return (p === null) - (q === null);
      const order = typeof p === "number" ? p - q : String(p).localeCompare(String(q), "en", { numeric: true });
      return sorting.up ? order : -order;
    });
    const head = element("tr");
    all.forEach((column, i) => {
      const th = element("th", { scope: "col", class: column.spread || column.number ? "number" : "" });
      if (i === sorting.column) th.setAttribute("aria-sort", sorting.up ? "ascending" : "descending");
      const button = element("button", { type: "button" }, column.name);
      button.addEventListener("click", () => {
        sorting = { column: i, up: sorting.column === i ? !sorting.up : true };
        tabulate();
        by("numbers").querySelectorAll("th button")[i].focus();
      });
      th.append(button);
      head.append(th);
    });
    by("numbers").tHead.replaceChildren(head);
    const body = rows.map((e) => {
      const row = element("tr");
      for (const column of all) {
        const text = column.spread ? ranged(column.spread(e), column.show) : (column.show ?? String)(column.of(e));
        const kinds = [column.spread || column.number ? "number" : "", column.name === "front" ? "best" : ""];
        const cell = element("td", { class: kinds.join(" ").trim() });
        // The range over seeds is smaller than the mean.
        const [mean, range] = column.spread ? text.split(" (") : [text];
        cell.append(mean);
        if (range) cell.append(element("small", {}, " (" + range));
        row.append(cell);
      }
      row.addEventListener("pointerenter", () => e.node?.classList.add("lit"));
      row.addEventListener("pointerleave", () => e.node?.classList.remove("lit"));
      e.row = row;
      return row;
    });
    by("numbers").tBodies[0].replaceChildren(...body);
  }

  function describe() {
    const m = metric();
    const counts = entries.map((e) => e.seeds);
    const [least, most] = [Math.min(...counts), Math.max(...counts)];
    const seeds = !counts.length ? "0" : least === most ? `${least}` : `${least} to ${most}`;
    const variants = new Set(entries.map((e) => e.group.variant)).size;
    const words = m.words ? `${m.name}: ${m.words}` : m.name;
    const material = by("material").selectedOptions[0]?.textContent ?? "";
    by("subtitle").textContent =
      `${words}. Shown: ${material}, split ${by("split").value}, level ${by("level").value}; ` +
      `${variants} variants, means over ${seeds} seed${seeds === "1" ? "" : "s"}.`;
  }
  function refresh() {
    entries = select();
    const shown = entries.filter((e) => e.x && e.y && !hidden.has(e.family.name));
    for (const e of entries) e.front = false;
    markFront(shown);
    by("tip").hidden = true;
    describe();
    draw();
    tabulate();
  }
  function legend() {
    by("legend").replaceChildren(
      ...data.families.map((family) => {
        const button = element("button", { type: "button", "aria-pressed": "true" });
        const swatch = drawn("svg", { width: 16, height: 16, viewBox: "-8 -8 16 16", "aria-hidden": "true" });
        swatch.append(drawn("path", { d: outline(family, 0, 0, 4.6), fill: colour(family) }));
        button.append(swatch, element("span", {}, family.name));
        button.addEventListener("click", () => {
          const hide = !hidden.delete(family.name);
          if (hide) hidden.add(family.name);
          button.setAttribute("aria-pressed", String(!hide));
          refresh();
        });
        return button;
      })
    );
  }

  const { start } = data;
  offer("metric", data.metrics.map((m) => [m.name, m.name]), start.metric);
  offer("cost", data.costs.map((c) => [c.key, c.words]), start.cost);
  offer("split", unique(data.groups.map((g) => g.split)).sort().map((s) => [s, s]), start.split);
  offerLevels(levelText(start.level));
  offerMaterials(data.groups.some((g) => g.material === null) ? "mean" : "0");
  const regimes = unique(data.variants.map((v) => v.regime)).sort().map((r) => ["=" + r, r]);
  offer("regime", [["", "all"], ...regimes], start.regime === null ? "" : "=" + start.regime);
  by("choices").addEventListener("change", (event) => {
    if (event.target.id === "split") offerLevels();
    if (event.target.id === "metric") {
      offerMaterials();
      sorting = { column: 3, up: !metric().higher };
    }
    refresh();
  });
  by("choices").addEventListener("submit", (event) => event.preventDefault());
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") by("tip").hidden = true;
  });
  legend();
  sorting.up = !metric().higher;
  refresh();
  let width = by("stage").clientWidth;
  new ResizeObserver(() => {
    // The chart's own height changes the stage as well.
    if (by("stage").clientWidth === width) return;
    width = by("stage").clientWidth;
    by("tip").hidden = true;
    draw();
  }).observe(by("stage"));
})();
