"use strict";
// Interaction of report pages: plots (by uPlot) to zoom and pan, tables to sort and filter, light and
// dark. Without scripts, pages have the same content except the plots.
(() => {
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];

  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  }

  function button(words, act, attributes = {}) {
    const made = element("button", { type: "button", ...attributes }, words);
    made.addEventListener("click", act);
    return made;
  }

  // Turns a span of the page into a button of the same look.
  function pressable(span, act) {
    const made = button("", act);
    for (const { name, value } of span.attributes) made.setAttribute(name, value);
    made.append(...span.childNodes);
    span.replaceWith(made);
    return made;
  }

  // Colours of the style sheet

  const probe = document.body.appendChild(element("i", { hidden: "" }));
  const color = (name) => {
    probe.style.color = `var(--${name})`;
    return getComputedStyle(probe).color;
  };

  const redraws = [];
  const redraw = () => redraws.forEach((act) => act());

  function addSchemes() {
    const root = document.documentElement;
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const isDark = () => (root.dataset.scheme ? root.dataset.scheme === "dark" : dark.matches);
    const toggle = button("", () => {
      root.dataset.scheme = isDark() ? "light" : "dark";
      show();
    }, { class: "scheme" });
    const show = () => {
      toggle.textContent = isDark() ? "Light" : "Dark";
      toggle.setAttribute("aria-label", `${toggle.textContent} colours`);
      redraw();
    };
    dark.addEventListener("change", show);
    let kept;
    addEventListener("beforeprint", () => {
      kept = root.dataset.scheme;
      root.dataset.scheme = "light";
      charts.forEach((chart) => chart.drawAll());
      redraw();
    });
    addEventListener("afterprint", () => {
      if (kept) root.dataset.scheme = kept;
      else delete root.dataset.scheme;
      redraw();
    });
    document.querySelector("header").append(toggle);
    show();
  }

  // Tables

  const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

  // The number at the start of a cell: 3.08 ± 0.01, −3 %, < 10⁻⁶, 1.2·10⁻⁷; null for words.
  function numberOf(text) {
    const plain = text.trim().replace(/−/g, "-").replace(/^[<>(]\s*/, "").replace(/^10(?=[⁻⁰-⁹¹²³])/, "1·10");
    const match = plain.match(/^-?[\d.]+/);
    if (!match) return null;
    const power = plain.slice(match[0].length).match(/^[^·]*·10(⁻?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+)/);
    if (!power) return Number(match[0]);
    const digits = [...power[2]].map((digit) => SUPERSCRIPTS.indexOf(digit)).join("");
    return Number(match[0]) * 10 ** ((power[1] ? -1 : 1) * Number(digits));
  }

  function compared(a, b) {
    const [x, y] = [numberOf(a), numberOf(b)];
    if (x !== null && y !== null) return x - y;
    if (x !== null || y !== null) return x === null ? 1 : -1;
    return a.localeCompare(b, undefined, { numeric: true });
  }

  // An empty cell has the words of the row above, such as an effect with several parameters.
  function fill(rows) {
    rows.slice(1).forEach((row, k) => {
      const cell = row.cells[0];
      if (!cell.textContent.trim()) cell.append(...[...rows[k].cells[0].cloneNode(true).childNodes]);
    });
  }

  function addSorting(table) {
    const body = table.tBodies[0];
    const totals = [...body.rows].filter((row) => row.classList.contains("total"));
    const rows = [...body.rows].filter((row) => !row.classList.contains("total"));
    if (rows.length < 2) return;
    const heads = [...table.tHead.rows[0].cells];
    const sort = (head, column) => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      if (heads[0].textContent) fill(rows);
      const text = (row) => row.cells[column].firstChild?.textContent ?? "";
      const ordered = [...rows].sort((a, b) => (down ? -1 : 1) * compared(text(a), text(b)));
      body.append(...ordered, ...totals);
    };
    heads.forEach((head, column) => {
      head.classList.add("sortable");
      head.tabIndex = 0;
      head.title = "Sort";
      head.addEventListener("click", () => sort(head, column));
      head.addEventListener("keydown", (event) => {
        if (event.key === "Enter") sort(head, column);
      });
    });
    if (rows.length > 4 && !table.closest(".abreast")) addFilter(table, rows);
  }

  function addFilter(table, rows) {
    const input = element("input", { class: "filter", type: "search", placeholder: "Filter rows", "aria-label": "Filter rows" });
    input.addEventListener("input", () => {
      fill(rows);
      const wanted = input.value.toLowerCase().split(/\s+/);
      for (const row of rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !wanted.every((word) => text.includes(word));
      }
    });
    table.closest(".wide").before(input);
  }

  // Plots

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const floats = (text) => Array.from(new Float32Array(bytes(text)));
  const decoded = ([offset, scale, text]) =>
    Array.from(new Int16Array(bytes(text)), (whole) => (whole === -32768 ? null : offset + scale * whole));

  const plain = (value) => (value == null ? "" : String(Number(value.toPrecision(6))).replace("-", "−"));

  const shown = new Set(); // keys of the shown stages, in all charts of the page
  const LEAST = 5e-4; // smallest share of the whole time in a zoomed view
  const CUT = 3; // residuals are cut off at this multiple of the best model's largest

  class Chart {
    constructor(root) {
      this.root = root;
      root.querySelector(".unscripted").remove();
      this.data = JSON.parse(root.querySelector("script").textContent);
      this.colors = Object.fromEntries(this.data.stages.map((stage) => [stage.key, stage.color]));
      this.view = [...this.data.ends];
      this.root.dataset.view = this.view.join(" ");
      this.plots = [];
      this.addControls();
      this.observer = new IntersectionObserver((entries) => {
        for (const { isIntersecting, target } of entries) if (isIntersecting) this.drawPanel(target);
      }, { rootMargin: "300px" });
      all(".panel", root).forEach((panel) => this.observer.observe(panel));
      redraws.push(() => this.plots.forEach((plot) => plot.redraw()));
    }

    addControls() {
      for (const span of all(".chip[data-stage]", this.root)) {
        const key = span.dataset.stage;
        if (span.getAttribute("aria-pressed") === "true") shown.add(key);
        pressable(span, () => showStage(key, !shown.has(key)));
      }
      if (!this.data.abreast) this.addTools();
      for (const span of all(".chip[data-joint]", this.root)) {
        const press = pressable(span, () => this.showJoint(press, press.getAttribute("aria-pressed") !== "true"));
        this.showJoint(press, press.getAttribute("aria-pressed") === "true");
      }
      all(".controls, .hint", this.root).forEach((part) => (part.hidden = false));
    }

    addTools() {
      const [low, high] = this.data.ends;
      const tools = element("div", { class: "tools" });
      for (const [words, title, act] of [
        ["+", "Zoom in", () => this.zoom(0.5)],
        ["−", "Zoom out", () => this.zoom(2)],
        ["←", "Earlier", () => this.pan(-0.3)],
        ["→", "Later", () => this.pan(0.3)],
        ["Reset", "Show all", () => this.look(low, high)],
      ]) tools.append(button(words, act, { title, "aria-label": title }));
      this.root.querySelector(".controls").append(tools);
      this.root.querySelector(".panels").before(element("p", { class: "hint" },
        "Drag to zoom, shift and drag to pan, double click to reset."));
      for (const item of all(".windows li", this.root)) {
        const [start, end] = [Number(item.dataset.start), Number(item.dataset.end)];
        const jump = () => {
          showStage(item.dataset.stage, true);
          this.look(start - (end - start), end + (end - start));
        };
        item.replaceChildren(button(item.textContent, jump, { title: "Zoom in here" }));
      }
    }

    showJoint(chip, show) {
      chip.setAttribute("aria-pressed", String(show));
      all("[data-title]", this.root).forEach((panel) => {
        if (panel.dataset.title === chip.dataset.joint) panel.hidden = !show;
      });
    }

    drawAll() {
      all(".panel", this.root).forEach((panel) => panel.hidden || this.drawPanel(panel));
    }

    look(low, high) {
      const [first, last] = this.data.ends;
      const width = Math.min(Math.max(high - low, LEAST * (last - first)), last - first);
      const start = Math.min(Math.max(low, first), last - width);
      this.view = [start, start + width];
      this.root.dataset.view = this.view.join(" ");
      for (const plot of this.plots) plot.setScale("x", { min: start, max: start + width });
    }

    // Zooms all plots to the view of the one that was zoomed by hand.
    follow(low, high) {
      const [start, end] = this.view;
      if (Math.abs(low - start) + Math.abs(high - end) > 1e-6 * (end - start)) this.look(low, high);
    }

    zoom(factor, at = 0.5) {
      const [low, high] = this.view;
      const middle = low + at * (high - low);
      this.look(middle - at * factor * (high - low), middle + (1 - at) * factor * (high - low));
    }

    pan(share) {
      const [low, high] = this.view;
      this.look(low + share * (high - low), high + share * (high - low));
    }

    drawPanel(panel) {
      this.observer.unobserve(panel);
      if (panel.dataset.drawn) return;
      panel.dataset.drawn = "yes";
      const data = this.data.panels[Number(panel.dataset.panel)];
      const time = floats(data.time);
      const curves = curvesOf(data.plots);
      all(".place", panel).forEach((place, k, places) => {
        const plot = data.plots[k];
        const readout = place.querySelector(".readout");
        const trends = Object.values(plot.trends).map((trend) => trend.map(decoded));
        const samples = [plot.over ? decoded(plot.over) : time, ...Object.values(curves[k])];
        const made = new uPlot(
          this.options(plot, data.shades, place, readout, k === 0, k === places.length - 1),
          trends.length ? uPlot.join([samples, ...trends]) : samples,
          place,
        );
        this.plots.push(made);
        made.stages = [...Object.keys(plot.curves), ...Object.keys(plot.trends).flatMap((key) => [key, key])];
        if (!this.data.abreast) {
          this.addHands(made);
          made.setScale("x", { min: this.view[0], max: this.view[1] });
        }
        new ResizeObserver(() => {
          if (place.clientWidth) made.setSize({ width: place.clientWidth, height: made.height });
        }).observe(place);
      });
    }

    options(plot, shades, place, readout, isFirst, isLast) {
      const stages = Object.fromEntries(this.data.stages.map((stage) => [stage.key, stage]));
      const keys = Object.keys(plot.curves);
      const alone = this.data.abreast; // each plot over an axis of its own
      const axis = { stroke: () => color("quiet"), font: "11px system-ui, sans-serif", ticks: { show: false },
        grid: { stroke: () => color("rule"), width: 0.7 } };
      return {
        width: place.clientWidth || 600,
        height: (plot.tall ? 172 : 108) + (isLast || alone ? 36 : 0),
        padding: [4, 12, 0, 0],
        legend: { show: false },
        cursor: {
          y: false,
          drag: { x: true, y: false },
          ...(alone ? {} : { sync: { key: this.root.id, setSeries: false } }),
          points: { size: 6, show: !alone },
          bind: alone ? {} : {
            mousedown: (u, target, start) => (event) => (event.shiftKey ? this.drag(u, event) : start(event)),
            dblclick: () => () => this.look(...this.data.ends),
          },
        },
        scales: {
          x: { time: false, range: (u, low, high) => [low, high] },
          y: plot.log ? { distr: 3 } : { range: (u, low, high) => spanOf(plot, u, low, high) },
        },
        axes: [
          alone ? { ...axis, size: 22, gap: 4, label: plot.axis, labelSize: 18, labelGap: 0, labelFont: "12px system-ui, sans-serif",
            values: (u, splits) => splits.map(plain) } : { ...axis, size: isLast ? 22 : 4, gap: 4, label: isLast ? this.data.axis : undefined, labelSize: 18, labelGap: 0,
            labelFont: "12px system-ui, sans-serif", splits: (u) => this.splits(u).map(([at]) => at),
            values: (u) => this.splits(u).map(([, words]) => (isLast ? words : "")) },
          { ...axis, size: 48, gap: 6, space: plot.tall ? 32 : 20,
            values: (u, splits) => splits.map(plain) },
        ],
        series: [{}, ...keys.map((key) => ({
          label: stages[key].label,
          show: shown.has(key),
          stroke: () => color(stages[key].color),
          width: stages[key].look === "wide" ? 3.2 : 1.3,
          points: { show: stages[key].look === "dots", size: 3 },
          paths: stages[key].look === "dots" ? () => null : line,
        })), ...Object.keys(plot.trends).flatMap((key) => [[1.8, []], [1, [4, 3]]].map(([width, dash]) => ({
          show: shown.has(key), stroke: () => color("ink"), width, dash, points: { show: false }, paths: line,
        })))],
        hooks: {
          drawClear: [(u) => this.drawGround(u, plot, shades)],
          draw: [(u) => isFirst && this.nameLogs(u)],
          setCursor: [(u) => alone || this.read(u, keys, stages, readout)],
          setScale: [(u, key) => !alone && key === "x" && u.status && this.follow(u.scales.x.min, u.scales.x.max)],
        },
      };
    }

    // Ticks of each log's own time: their positions on the axis, and their labels.
    splits(u) {
      const [low, high] = [u.scales.x.min, u.scales.x.max];
      const rough = (80 * (high - low)) / Math.max(u.bbox.width / devicePixelRatio, 80);
      const power = 10 ** Math.floor(Math.log10(rough));
      const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
      const found = [];
      for (const [, first, last, shift] of this.data.spans) {
        const end = Math.min(last, high - shift);
        const count = found.length;
        for (let k = Math.ceil(Math.max(first, low - shift) / step - 1e-9); k * step <= end + 1e-9 * step; k++)
          found.push([k * step + shift, String(Number((k * step).toPrecision(8))).replace("-", "−")]);
        const at = first + shift; // a short log has a tick at its start
        if (found.length === count && at >= low && at <= high && !(found.at(-1)?.[0] > at - 0.5 * step))
          found.push([at, first.toFixed(1)]);
      }
      return found;
    }

    drawGround(u, plot, shades) {
      const { ctx, bbox } = u;
      const x = (value) => u.valToPos(value, "x", true);
      const y = (value) => u.valToPos(value, "y", true);
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      for (const [stage, start, end] of shades) {
        if (!shown.has(stage)) continue;
        ctx.globalAlpha = 0.14;
        ctx.fillStyle = color(this.colors[stage]);
        ctx.fillRect(x(start), bbox.top, Math.max(2, x(end) - x(start)), bbox.height);
      }
      if (plot.floor > 0) {
        ctx.globalAlpha = 0.2;
        ctx.fillStyle = color("noise");
        ctx.fillRect(bbox.left, y(plot.floor), bbox.width, Math.max(1, y(-plot.floor) - y(plot.floor)));
      }
      ctx.globalAlpha = 0.7;
      ctx.strokeStyle = color("quiet");
      ctx.lineWidth = devicePixelRatio;
      const line = (from, to, dashes) => {
        ctx.setLineDash(dashes.map((length) => length * devicePixelRatio));
        ctx.beginPath();
        ctx.moveTo(...from);
        ctx.lineTo(...to);
        ctx.stroke();
      };
      const [left, right, top, bottom] = [bbox.left, bbox.left + bbox.width, bbox.top, bbox.top + bbox.height];
      for (const limit of plot.limits) line([left, y(limit)], [right, y(limit)], [2, 3]);
      if (plot.centred) line([left, y(0)], [right, y(0)], []);
      if (this.data.abreast) return void ctx.restore();
      for (const [, first, , shift] of this.data.spans.slice(1))
        line([x(first + shift), top], [x(first + shift), bottom], [4, 3]);
      ctx.restore();
    }

    nameLogs(u) {
      if (this.data.spans.length < 2) return;
      const { ctx, bbox } = u;
      ctx.save();
      ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
      ctx.fillStyle = color("quiet");
      ctx.textBaseline = "top";
      ctx.textAlign = "left";
      for (const [name, first, last, shift] of this.data.spans) {
        const left = Math.max(u.valToPos(first + shift, "x", true), bbox.left) + 5;
        const right = Math.min(u.valToPos(last + shift, "x", true), bbox.left + bbox.width);
        if (ctx.measureText(name).width < right - left) ctx.fillText(name, left, bbox.top + 2);
      }
      ctx.restore();
    }

    read(u, keys, stages, readout) {
      const at = u.cursor.idx;
      readout.replaceChildren();
      if (at == null || u.cursor.left < 0) return;
      const time = u.data[0][at];
      const span = this.data.spans.find(([, , last, shift]) => time <= last + shift + 1e-6);
      readout.append(`${(time - (span ? span[3] : 0)).toFixed(3)} ${this.data.unit}`);
      keys.forEach((key, k) => {
        const value = u.data[k + 1][at];
        if (!shown.has(key) || value == null) return;
        const words = `${stages[key].label} ${value.toPrecision(4).replace("-", "−")}`;
        readout.append(element("i", { style: `--c: var(--${stages[key].color})` }, words));
      });
    }

    // Pans a plot with the mouse until it is released.
    drag(u, event) {
      const [low, high] = this.view;
      const start = event.clientX;
      const width = u.over.clientWidth;
      const move = (now) => {
        const shift = ((now.clientX - start) / width) * (high - low);
        this.look(low - shift, high - shift);
      };
      document.addEventListener("pointermove", move);
      const release = () => document.removeEventListener("pointermove", move);
      for (const end of ["pointerup", "pointercancel"]) document.addEventListener(end, release, { once: true });
    }

    addHands(u) {
      u.over.addEventListener("pointerdown", (event) => {
        if (event.pointerType === "touch") this.drag(u, event);
      });
      u.over.addEventListener("wheel", (event) => {
        const across = Math.abs(event.deltaX) > Math.abs(event.deltaY);
        if (!event.ctrlKey && !across) return; // the page scrolls
        event.preventDefault();
        if (across) this.pan(event.deltaX / u.over.clientWidth);
        else this.zoom(Math.exp(0.004 * event.deltaY), event.offsetX / u.over.clientWidth);
      }, { passive: false });
    }
  }

  // Curves of a joint's plots. A curve without data is the first one minus its residual.
  function curvesOf(plots) {
    const curves = plots.map((plot) =>
      Object.fromEntries(Object.entries(plot.curves).map(([key, pack]) => [key, pack && decoded(pack)])));
    const residuals = curves.find((_, k) => plots[k].centred);
    const [first] = Object.values(curves[0]);
    for (const [key, values] of Object.entries(curves[0]))
      if (!values) curves[0][key] = first.map((value, k) => (value === null ? null : value - residuals[key][k]));
    return curves;
  }

  // Range of a plot: that of the shown curves in the shown time.
  function spanOf(plot, u, low, high) {
    if (plot.span) return plot.span;
    if (low == null || high == null) return [-1, 1];
    if (!plot.centred) {
      [low, high] = [Math.min(low, ...plot.limits), Math.max(high, ...plot.limits)];
      const margin = 0.06 * (high - low) || 0.5 * Math.abs(high) || 1;
      return [low - margin, high + margin];
    }
    const [first, last] = u.series[0].idxs ?? [0, u.data[0].length - 1];
    const peaks = u.data.slice(1, 1 + Object.keys(plot.curves).length).filter((_, k) => u.series[k + 1].show).map((curve) => {
      let peak = 0;
      for (let k = first; k <= last; k++) peak = Math.max(peak, Math.abs(curve[k] ?? 0));
      return peak;
    }).filter((peak) => peak > 0);
    const most = 1.08 * (peaks.length ? Math.min(Math.max(...peaks), CUT * Math.min(...peaks)) : 1);
    return [-most, most];
  }

  // A line that breaks at missing samples (null), and skips those of other curves (undefined).
  function line(u, k, first, last) {
    const stroke = new Path2D();
    let begun = false;
    for (let i = first; i <= last; i++) {
      const value = u.data[k][i];
      if (value === undefined) continue;
      if (value !== null) {
        const [x, y] = [u.valToPos(u.data[0][i], "x", true), u.valToPos(value, u.series[k].scale, true)];
        if (!begun) stroke.moveTo(x - 0.5, y);
        stroke.lineTo(x, y);
      }
      begun = value !== null;
    }
    return { stroke, fill: null, clip: null, band: null, gaps: null, flags: 1 };
  }

  const charts = [];

  function showStage(key, show) {
    shown[show ? "add" : "delete"](key);
    all(".chip[data-stage]").forEach((chip) => {
      if (chip.dataset.stage === key) chip.setAttribute("aria-pressed", String(show));
    });
    for (const chart of charts)
      for (const plot of chart.plots)
        plot.series.forEach((series, k) => {
          if (k && plot.stages[k - 1] === key) plot.setSeries(k, { show });
        });
    redraw(); // for the shades
  }

  for (const root of all(".chart")) {
    const made = new Chart(root);
    charts.push(made);
  }
  all("table").forEach(addSorting);
  addSchemes();
})();
