// Pan, zoom and read the numbers behind a picture: see explorer.py
(() => {
  const SMALL = 150, LARGE = 270, TOP = 18, BOTTOM = 34, LEFT = 64, RIGHT = 12, COLOURS = 6;
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const plain = name => /measured|set-point/.test(name) && !/^error of /.test(name);
  const bound = name => /limit|asked|^sensitivity /.test(name);
  const make = (tag, text, more) => Object.assign(document.createElement(tag), text ? {textContent: text} : {}, more || {});
  const short = v => !isFinite(v) ? "\u2013"
    : Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(2) : String(+v.toPrecision(5));

  function cells(text) {
    const rows = [[""]];
    let quoted = false;
    for (let i = 0; i < text.length; i++) {
      const c = text[i], row = rows[rows.length - 1];
      if (quoted) {
        if (c !== '"') row[row.length - 1] += c;
        else if (text[i + 1] === '"') { row[row.length - 1] += c; i++; }
        else quoted = false;
      } else if (c === '"') quoted = true;
      else if (c === ",") row.push("");
      else if (c === "\n") rows.push([""]);
      else row[row.length - 1] += c;
    }
    if (rows[rows.length - 1].length === 1 && !rows[rows.length - 1][0]) rows.pop();
    return rows;
  }

  // the numbers of a figure: [{name, unit, values}], or null
  function numbers(figure) {
    const packed = figure.querySelector("script[data-columns]");
    const named = title => { const m = /^([^]*?)(?: \[([^\]]*)\])?$/.exec(title); return {name: m[1], unit: m[2] || ""}; };
    if (packed) {
      const columns = JSON.parse(packed.dataset.columns), n = +packed.dataset.rows;
      const all = new Int16Array(Uint8Array.from(atob(packed.textContent), c => c.charCodeAt(0)).buffer);
      let next = 0;
      return columns.map(c => {
        if (c.wide) return {...named(c.title), values: new Float64Array(Uint8Array.from(atob(c.wide), b => b.charCodeAt(0)).buffer)};
        if (c.even) return {...named(c.title), values: Float64Array.from({length: n}, (_, i) => c.low + c.step * i)};
        const own = all.subarray(next * n, ++next * n);
        return {...named(c.title), values: Float64Array.from(own, v => v === -32768 ? NaN : c.low + c.step * (v + 32767))};
      });
    }
    const link = figure.querySelector('.tools a[href^="data:"]');
    if (!link) return null;
    const href = link.getAttribute("href"), rows = cells(decodeURIComponent(href.slice(href.indexOf(",") + 1)));
    const columns = [];
    for (let j = 0; j < rows[0].length; j++) {
      const values = Float64Array.from(rows.slice(1), row => row[j] === "" ? NaN : Number(row[j]));
      for (let k = 0; k < values.length; k++) if (/^-?inf$/.test(rows[k + 1][j])) values[k] = NaN;
      if (!rows.slice(1).some((row, k) => !/^(-?inf)?$/.test(row[j]) && isNaN(values[k]))) columns.push({...named(rows[0][j]), values});
    }
    return columns;
  }

  const panel = c => (c.error ? "error " : "") + c.unit;

  // measured minus what each model makes of it, in a panel of their own
  function errors(columns) {
    const one = columns.filter(c => / measured$/.test(c.name) && !c.spread);
    if (one.length !== 1) return [];
    const [m] = one, own = m.name.slice(0, -"measured".length);
    const models = columns.filter(c => c !== m && c.unit === m.unit && c.name.startsWith(own) && !/ (low|high)$/.test(c.name));
    return models.map(c => (
      {name: "error of " + c.name.slice(own.length), unit: m.unit, error: true, values: m.values.map((v, i) => v - c.values[i])}));
  }

  // {kind, x, series: [{name, unit, colour, values}]}; of a family at: [..] and of: its column; in the plane series have an x too
  function view(columns, kind) {
    const x = columns[0], rest = columns.slice(1);
    const count = {}, taken = {}; // colours begin anew in every panel; both ends of a band have one
    const next = c => {
      if (plain(c.name) || bound(c.name)) return 0;
      const key = panel(c), own = key + c.name.replace(/ (low|high)$/, "");
      if (!(own in taken)) taken[own] = (count[key] = (count[key] || 0) + 1) - 1;
      return taken[own];
    };
    const series = own => own.map(c => {
      const i = next(c);
      return {...c, colour: i % COLOURS + 1, dashed: i >= COLOURS || bound(c.name)};
    });
    const spread = rest.findIndex(c => c.name === "standard deviation");
    if (spread > 0) rest.splice(spread - 1, 2, {...rest[spread - 1], spread: rest[spread].values});
    if (kind === "line") return {kind, x, series: series([...rest, ...errors(rest)])};
    if (kind === "family") {
      const starts = [0];
      for (let i = 1; i < x.values.length; i++) if (!(x.values[i] > x.values[i - 1])) starts.push(i);
      const at = starts.map(s => rest[0].values[s]);
      return {kind, x, series: series(rest.slice(1)), of: rest[0], at, each: x.values.length / starts.length};
    }
    const pairs = [];
    for (let i = 0; i + 1 < columns.length; i += 2)
      pairs.push({name: columns[i].name.slice(0, -5), unit: "", values: columns[i + 1].values, x: columns[i].values});
    return {kind, x: {name: "real part", unit: "", values: columns[0].values}, series: series(pairs)};
  }

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map(m => m * power).find(s => s >= raw), found = [];
    for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) found.push(Math.abs(v) < 1e-9 * step ? 0 : v);
    return found;
  }

  function explore(figure, first, others) {
    const place = figure.querySelector(".picture"), svg = place.querySelector("svg");
    let shown = first, part = 0, range = null, cursor = null, hidden = new Set();
    const box = make("div", "", {className: "explorer"}), canvas = make("canvas", "", {tabIndex: 0});
    const said = make("output", ""), bar = make("div", "", {className: "controls"}), names = make("div", "", {className: "series"});
    said.setAttribute("aria-live", "polite");
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", figure.querySelector("h3").textContent
      + ": arrow keys move the cursor, plus and minus zoom, shift and arrows pan, 0 shows all");
    const button = (text, what, label) => {
      const b = make("button", text, {type: "button", onclick: what});
      if (label) b.setAttribute("aria-label", label);
      bar.append(b);
      return b;
    };
    const log = () => /rad\/s|Hz/.test(shown.x.unit) && Math.min(...extent(shown.x.values)) > 0 && shown.kind !== "plane";
    const to = v => log() ? Math.log10(v) : v, back = v => log() ? 10 ** v : v;
    const rows = () => shown.kind === "family" ? [part * shown.each, (part + 1) * shown.each] : [0, shown.x.values.length];
    const xs = s => s.x || shown.x.values;
    const ink = s => bound(s.name) ? "muted" : plain(s.name) ? "measured" : "series-" + s.colour;

    function extent(values, from, until) {
      let low = Infinity, high = -Infinity;
      for (let i = from || 0; i < (until === undefined ? values.length : until); i++) {
        if (values[i] < low) low = values[i];
        if (values[i] > high) high = values[i];
      }
      return [low, high];
    }
    function whole() {
      if (shown.kind === "plane") return [-2, 1];
      const [a, b] = rows(), own = extent(shown.x.values, a, b).map(to);
      return own;
    }
    function visible() { return shown.series.filter(s => !hidden.has(s.name)); }
    function panels() {
      if (shown.kind === "plane") return [{unit: "", series: visible()}];
      const keys = [...new Set(visible().map(panel))];
      return keys.map(key => {
        const series = visible().filter(s => panel(s) === key);
        return {unit: series[0].unit, error: series[0].error, series};
      });
    }

    function draw() {
      const all = panels(), plane = shown.kind === "plane";
      const PANEL = all.length > 1 ? SMALL : LARGE;
      const height = plane ? canvas.clientWidth * .62 : TOP + BOTTOM + PANEL * Math.max(1, all.length);
      canvas.style.height = height + "px";
      const width = canvas.clientWidth, scale = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
      canvas.width = Math.round(width * scale); canvas.height = Math.round(height * scale);
      pen.setTransform(scale, 0, 0, scale, 0, 0);
      pen.font = "12px system-ui, sans-serif";
      pen.clearRect(0, 0, width, height);
      const [low, high] = range || whole(), W = width - LEFT - RIGHT, X = v => LEFT + (v - low) / (high - low) * W;
      const muted = colour("muted"), grid = colour("grid");
      all.forEach((panel, k) => {
        const y0 = TOP + k * PANEL, h = plane ? height - TOP - BOTTOM : PANEL - 18, [a, b] = rows();
        let bottom = Infinity, top = -Infinity;
        if (plane) {
          top = (high - low) * h / W / 2;
          bottom = -top;
        } else for (const s of panel.series) {
          const x = xs(s);
          for (let i = a; i < b; i++) {
            const t = to(x[i]), v = s.values[i];
            const more = s.spread ? 2 * s.spread[i] : 0;
            if (t >= low && t <= high && isFinite(v)) { bottom = Math.min(bottom, v - more); top = Math.max(top, v + more); }
          }
        }
        if (!(top >= bottom)) { bottom = 0; top = 1; }
        if (top === bottom) { bottom -= Math.abs(bottom) * .1 || 1; top += Math.abs(top) * .1 || 1; }
        const room = plane ? 0 : .05 * (top - bottom);
        const Y = v => y0 + h - (v - bottom + room) / (top - bottom + 2 * room) * h;
        pen.strokeStyle = grid; pen.fillStyle = muted; pen.lineWidth = 1;
        for (const v of ticks(bottom, top, 4)) {
          pen.beginPath(); pen.moveTo(LEFT, Y(v)); pen.lineTo(width - RIGHT, Y(v)); pen.stroke();
          pen.textAlign = "right"; pen.textBaseline = "middle"; pen.fillText(short(v), LEFT - 6, Y(v));
        }
        const powers = log() ? ticks(Math.ceil(low), Math.floor(high), Math.max(1, Math.floor(high) - Math.ceil(low))) : [];
        for (const v of powers.length > 1 ? powers : ticks(low, high, Math.max(2, W / 90))) {
          pen.beginPath(); pen.moveTo(X(v), y0); pen.lineTo(X(v), y0 + h); pen.stroke();
          if (k < all.length - 1) continue;
          pen.textAlign = "center"; pen.textBaseline = "top";
          pen.fillText(short(back(v)), X(v), y0 + h + 5);
        }
        pen.textAlign = "left"; pen.textBaseline = "bottom";
        const unit = (panel.error ? "error " : "") + (panel.unit ? "[" + panel.unit + "]" : "");
        if (unit) pen.fillText(unit, 4, y0 - 3);
        pen.save(); pen.beginPath(); pen.rect(LEFT, y0, W, h); pen.clip();
        if (plane) { // the point that no curve of a stable loop encloses
          pen.strokeStyle = colour("ink");
          pen.beginPath();
          pen.moveTo(X(-1) - 6, Y(0)); pen.lineTo(X(-1) + 6, Y(0)); pen.moveTo(X(-1), Y(0) - 6); pen.lineTo(X(-1), Y(0) + 6);
          pen.stroke();
        }
        for (const s of panel.series) {
          const high = / low$/.test(s.name) && panel.series.find(o => o.name === s.name.slice(0, -4) + " high");
          if (high) band(pen, s, high, v => X(to(v)), Y);
        }
        for (const s of panel.series) {
          pen.strokeStyle = colour(ink(s));
          pen.lineWidth = 1.4; pen.setLineDash(s.dashed ? [5, 3] : []);
          const x = xs(s);
          if (s.spread) { points(pen, s, v => X(to(v)), Y); continue; }
          pen.beginPath();
          let open = false, column = null, lo = 0, hi = 0, lastY = 0;
          const flush = () => { // samples of one column of the screen: from its lowest to its highest
            if (column !== null && hi !== lo) for (const y of [lo, hi, lastY]) pen.lineTo(column, y);
          };
          let i = a, until = b;
          if (!plane && !log()) {
            i = Math.max(a, lower(x, low, a, b) - 1);
            until = Math.min(b, lower(x, high, a, b) + 2);
          }
          for (; i < until; i++) {
            const px = X(plane ? x[i] : to(x[i])), py = Y(s.values[i]);
            if (!isFinite(px) || !isFinite(py)) { flush(); column = null; open = false; continue; }
            const c = Math.round(px * 2) / 2;
            if (!plane && open && c === column) {
              lo = Math.min(lo, py); hi = Math.max(hi, py); lastY = py;
              continue;
            }
            flush();
            if (open) pen.lineTo(px, py); else pen.moveTo(px, py);
            open = true; column = c; lo = hi = lastY = py;
          }
          flush(); pen.stroke();
        }
        pen.setLineDash([]);
        if (cursor !== null && !plane) {
          pen.strokeStyle = muted; pen.beginPath();
          const cx = X(to(shown.x.values[cursor])); pen.moveTo(cx, y0); pen.lineTo(cx, y0 + h); pen.stroke();
        }
        pen.restore();
      });
      pen.fillStyle = muted; pen.textAlign = "center"; pen.textBaseline = "bottom";
      pen.fillText(shown.x.name + (shown.x.unit ? " [" + shown.x.unit + "]" : ""), LEFT + W / 2, height - 2);
    }
    function band(pen, low, high, X, Y) {
      const [a, b] = rows(), x = xs(low), step = Math.max(1, Math.floor((b - a) / 4000));
      pen.fillStyle = colour(ink(low)); pen.globalAlpha = .15;
      pen.beginPath();
      for (let i = a; i < b; i += step) if (isFinite(high.values[i])) pen.lineTo(X(x[i]), Y(high.values[i]));
      for (let i = b - 1; i >= a; i -= step) if (isFinite(low.values[i])) pen.lineTo(X(x[i]), Y(low.values[i]));
      pen.fill(); pen.globalAlpha = 1;
    }
    function points(pen, s, X, Y) { // means with two standard deviations
      const [a, b] = rows(), x = xs(s);
      pen.fillStyle = colour(ink(s)); pen.setLineDash([]);
      for (let i = a; i < b; i++) if (isFinite(s.values[i])) {
        const v = s.values[i], px = X(x[i]);
        pen.beginPath(); pen.moveTo(px, Y(v - 2 * s.spread[i])); pen.lineTo(px, Y(v + 2 * s.spread[i])); pen.stroke();
        pen.beginPath(); pen.arc(px, Y(v), 2.5, 0, 2 * Math.PI); pen.fill();
      }
    }
    function lower(values, v, a, b) { // the first from a on that is not below v
      while (a < b) { const m = (a + b) >> 1; if (values[m] < v) a = m + 1; else b = m; }
      return a;
    }
    function at(clientX) {
      const r = canvas.getBoundingClientRect(), [low, high] = range || whole();
      return low + (clientX - r.left - LEFT) / (r.width - LEFT - RIGHT) * (high - low);
    }
    function nearest(v) {
      const x = shown.x.values, [a, b] = rows();
      let i = lower(x, back(v), a, b);
      if (i > a && (i === b || Math.abs(to(x[i - 1]) - v) < Math.abs(to(x[i]) - v))) i--;
      return Math.min(Math.max(i, a), b - 1);
    }
    function tell() {
      if (cursor === null || shown.kind === "plane") return;
      const unit = u => u ? " " + u : "";
      said.textContent = shown.x.name + " " + short(shown.x.values[cursor]) + unit(shown.x.unit)
        + visible().map(s => " \u00b7 " + s.name + " " + short(s.values[cursor]) + unit(s.unit)).join("");
    }
    function move(low, high) {
      const [a, b] = whole(), width = Math.min(Math.max(high - low, (b - a) * 1e-5), shown.kind === "plane" ? 60 : b - a);
      if (shown.kind !== "plane") { low = Math.min(Math.max(low, a), b - width); }
      range = [low, low + width];
      if (shown.kind !== "plane" && width >= (b - a) * (1 - 1e-9)) range = null;
      draw();
    }
    function zoom(factor, centre) {
      const [low, high] = range || whole(), c = centre === undefined ? (low + high) / 2 : centre;
      move(c - (c - low) * factor, c + (high - c) * factor);
    }
    function pan(share) { const [low, high] = range || whole(), d = share * (high - low); move(low + d, high + d); }

    function listed() {
      names.replaceChildren(...shown.series.map(s => {
        const b = make("button", s.name, {type: "button"});
        b.style.setProperty("--own", "var(--" + ink(s) + ")");
        b.setAttribute("aria-pressed", String(!hidden.has(s.name)));
        b.onclick = () => {
          if (hidden.has(s.name)) hidden.delete(s.name); else if (visible().length > 1) hidden.add(s.name);
          b.setAttribute("aria-pressed", String(!hidden.has(s.name)));
          draw(); tell();
        };
        return b;
      }));
    }
    button("+", () => zoom(.5, cursor === null ? undefined : to(shown.x.values[cursor])), "zoom in");
    button("\u2212", () => zoom(2), "zoom out");
    button("\u2190", () => pan(-.25), "earlier");
    button("\u2192", () => pan(.25), "later");
    button("all", () => { range = null; draw(); }, "show all");
    let turn = () => {};
    if (others.length > 1) {
      const choose = make("select"), label = make("label", "record ");
      others.forEach((o, i) => choose.append(make("option", o.title, {value: i, selected: o.own})));
      choose.onchange = () => {
        shown = of(others[choose.value].figure);
        range = cursor = null; said.textContent = ""; hidden.clear();
        listed(); turn(); draw();
      };
      label.append(choose); bar.append(label);
    }
    if (shown.kind === "family") {
      const slide = make("input", "", {type: "range", min: 0, max: shown.at.length - 1, value: 0});
      const label = make("label", shown.of.name + " "), value = make("span");
      turn = () => {
        slide.max = shown.at.length - 1;
        part = Math.min(+slide.value, shown.at.length - 1); cursor = null;
        value.textContent = short(shown.at[part]) + " " + shown.of.unit;
        slide.setAttribute("aria-valuetext", value.textContent);
        draw();
      };
      slide.oninput = turn;
      label.append(slide, value); bar.append(label);
      setTimeout(turn);
    }
    const close = button("Picture", () => {
      box.remove(); place.append(svg); watch.disconnect();
      for (const b of tools) b.hidden = false;
      opener.focus();
    }, "back to the picture");
    const pointers = new Map();
    canvas.onpointerdown = e => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, e.clientX); };
    canvas.onpointerup = canvas.onpointercancel = e => pointers.delete(e.pointerId);
    canvas.onpointermove = e => {
      if (!pointers.size) { if (shown.kind !== "plane") { cursor = nearest(at(e.clientX)); draw(); tell(); } return; }
      if (!pointers.has(e.pointerId)) return;
      const before = [...pointers.values()]; pointers.set(e.pointerId, e.clientX); const after = [...pointers.values()];
      if (before.length === 1) {
        const d = at(before[0]) - at(after[0]), [low, high] = range || whole();
        move(low + d, high + d);
      } else zoom(Math.abs(before[0] - before[1]) / Math.max(Math.abs(after[0] - after[1]), 1), at((after[0] + after[1]) / 2));
    };
    canvas.onpointerleave = () => { if (!pointers.size && document.activeElement !== canvas) { cursor = null; draw(); } };
    canvas.addEventListener("wheel", e => {
      if (document.activeElement !== canvas && !e.ctrlKey) return; // the page scrolls until one works in here
      e.preventDefault();
      zoom(e.deltaY > 0 ? 1.25 : .8, at(e.clientX));
    }, {passive: false});
    canvas.onkeydown = e => {
      const step = {ArrowLeft: -1, ArrowRight: 1}[e.key];
      if (step && e.shiftKey) pan(.1 * step);
      else if (step && shown.kind !== "plane") {
        const [a, b] = rows(), [low, high] = range || whole(), [first, last] = whole();
        const jump = Math.max(1, Math.round((high - low) / (last - first || 1) * (b - a) / 200));
        cursor = Math.min(Math.max(cursor === null ? nearest((low + high) / 2) : cursor + step * jump, a), b - 1);
        draw(); tell();
      } else if (e.key === "+" || e.key === "=") zoom(.5, cursor === null ? undefined : to(shown.x.values[cursor]));
      else if (e.key === "-") zoom(2);
      else if (e.key === "0" || e.key === "Home") { range = null; draw(); }
      else if (e.key === "Escape") close.click();
      else return;
      e.preventDefault();
    };
    const watch = new ResizeObserver(() => draw());
    const tools = figure.querySelectorAll(".tools button"), opener = figure.querySelector(".explore");
    svg.remove(); box.append(bar, canvas, said, names); place.append(box); listed();
    for (const b of tools) b.hidden = true;
    watch.observe(canvas); matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    draw(); canvas.focus({preventScroll: true});
  }

  // numbers are read when they are asked for: a page of many records must open at once
  const figures = [...document.querySelectorAll("figure[data-view]")], read = new Map();
  const of = figure => {
    if (!read.has(figure)) read.set(figure, view(numbers(figure), figure.dataset.view));
    return read.get(figure);
  };
  for (const figure of figures) {
    const open = make("button", "Explore", {type: "button", className: "explore"});
    open.setAttribute("aria-label", "Explore: " + figure.querySelector("h3").textContent);
    open.onclick = () => {
      const same = figures.filter(f => f.dataset.view === figure.dataset.view && f.dataset.columns === figure.dataset.columns);
      explore(figure, of(figure), same.map(f => ({title: f.querySelector("h3").textContent, figure: f, own: f === figure})));
    };
    figure.querySelector(".tools").append(open);
  }
})();
