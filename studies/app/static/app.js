// The bench: one page over the commands of the command line. All that is known lies in the session's folder; the server is asked
// for it again and again, so that two windows and the command line see the same.

const STAGES = [
  {id: "logs", title: "Logs", kinds: ["look"], aim: "Drop your logs as the machine wrote them, and say what each channel is."},
  {id: "model", title: "Model", kinds: ["identify"], aim: "A model from the records alone, scored on what it never saw."},
  {id: "machine", title: "Machine", kinds: ["effects"], aim: "What is believed of the machine: its equation with the values of the data sheet."},
  {id: "diagnosis", title: "Diagnosis", kinds: ["diagnose", "calibrate"], aim: "What the equation gets wrong on the records, and its cause."},
  {id: "controller", title: "Controller", kinds: ["design"], aim: "A controller with bounds on its margins at every schedule value."},
  {id: "check", title: "Check", kinds: ["check"], aim: "Does the loop keep its limits on every machine that the records leave open?"},
  {id: "export", title: "Export", kinds: ["export"], aim: "The controller as source text or tables for another program."},
];
const MODELS = ["lpv-model", "hammerstein-wiener-model"];

let S = null;             // the session, as the server says it
let fields = {};          // what stands in the fields of each stage
let drawn = "";           // of which the panel was drawn last
let chosenRun = null;     // a run that was picked from the list
const panel = document.getElementById("panel");

// ---- asking the server -----------------------------------------------------------------------------------------------

async function ask(path, method = "GET", body) {
  const headers = method === "GET" ? {} : {"X-Workbench": "1"};
  const raw = body instanceof Blob;
  if (body !== undefined && !raw) headers["Content-Type"] = "application/json";
  const answer = await fetch(path, {method, headers, body: body === undefined ? undefined : raw ? body : JSON.stringify(body)});
  const text = await answer.text();
  let content;
  try { content = JSON.parse(text); } catch { content = {error: text}; }
  if (!answer.ok) throw new Error(content.error || `${answer.status}`);
  return content;
}

let silence;
function say(text) {
  const place = document.getElementById("said");
  place.textContent = text;
  place.hidden = !text;
  clearTimeout(silence);
  if (text) silence = setTimeout(() => say(""), 12000);
}

const attempt = action => async (...given) => {
  try { await action(...given); } catch (reason) { say(reason.message); }
};

let waiting;
async function refresh() {
  clearTimeout(waiting);
  try {
    S = await ask("/api/session");
    draw();
  } catch (reason) {
    say(`The workbench does not answer: ${reason.message}. Is \`workbench app\` still running?`);
  }
  const busy = S && S.steps.some(step => step.state === "running");
  waiting = setTimeout(refresh, busy ? 800 : 4000);
}

/** Change the session: changes(chosen) says how, from what it holds by then; one after the other, however fast a hand is. */
let changed = Promise.resolve();
const choose = changes => (changed = changed.then(attempt(async () => {
  S.chosen = await ask("/api/session", "PUT", {revision: S.chosen.revision, ...changes(S.chosen)});
})).then(refresh));

const begin = attempt(async words => {
  chosenRun = (await ask("/api/steps", "POST", {words})).name;
  await refresh();
});

const stop = attempt(async name => {
  await ask(`/api/steps/${encodeURIComponent(name)}/stop`, "POST");
  await refresh();
});

// ---- making elements ---------------------------------------------------------------------------------------------------

function el(name, own = {}, ...inside) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(own)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== undefined && value !== null) made.setAttribute(key, value);
  }
  made.append(...inside.flat().filter(part => part !== null && part !== undefined && part !== false));
  return made;
}

/** A field of a stage: what stands in it outlives a redraw. */
function field(stage, key, text, usual, make) {
  const own = (fields[stage] ??= {});
  if (!(key in own) || (own[key].untouched && own[key].value !== usual)) own[key] = {value: usual, untouched: true};
  const input = make(own[key].value);
  input.id = `${stage}-${key}`;
  input.addEventListener("input", () => { own[key] = {value: input.value, untouched: false}; preview(); });
  const output = input.type === "range" ? el("output", {for: input.id}, own[key].value) : null;
  if (output) input.addEventListener("input", () => { output.textContent = input.value; });
  return el("label", {for: input.id}, text, output, input);
}
const value = (stage, key) => fields[stage]?.[key]?.value ?? "";
const text = (stage, key, label, usual, more = {}) =>
  field(stage, key, label, usual, now => { const made = el("input", {type: "text", spellcheck: "false", ...more}); made.value = now; return made; });
const range = (stage, key, label, usual, low, high, step) =>
  field(stage, key, label, String(usual), now => { const made = el("input", {type: "range", min: low, max: high, step}); made.value = now; return made; });
function select(stage, key, label, options, usual = options[0]?.[0] ?? "") {
  const known = options.map(([name]) => name);
  const own = (fields[stage] ??= {});
  if (own[key] && !known.includes(own[key].value)) delete own[key];
  return field(stage, key, label, usual, now => {
    const made = el("select", {}, options.map(([name, said]) => el("option", {value: name}, said)));
    made.value = now;
    return made;
  });
}

// ---- what is known -------------------------------------------------------------------------------------------------------

const files = use => S.records.filter(own => own.use === use).map(own => `records/${own.name}`);
const roleOf = channel => S.chosen.roles[channel.name] ?? channel.role;
const named = role => S.channels.filter(channel => roleOf(channel) === role);
const made = kinds => S.files.filter(own => kinds.includes(own.kind)).map(own => own.path);
const newest = paths => [...paths].sort((a, b) => number(b) - number(a));
const number = path => parseInt(path, 10) || 0;
const stamps = () => (S.chosen.dt ? ["--file-dt", String(S.chosen.dt)] : []);
const short = x => Number(x.toPrecision(4)).toString();
const list = channels => channels.map(channel => channel.name).join(",");

function roles(scheduleless) {
  const words = ["--outputs", list(named("output")), "--inputs", list(named("input"))];
  const schedule = list(named("schedule"));
  return schedule ? [...words, "--schedule", schedule] : [...words, ...scheduleless];
}
const holdout = () => (files("held-out").length ? ["--holdout", ...files("held-out")] : []);
const plantOf = () => S.chosen.plant || (S.texts["plant.py"] !== undefined ? "plant.py:PLANT" : "");
const missing = () =>
  !files("model").length ? "Drop a log first." :
  !S.channels.length ? "Wait until the logs have been looked at." :
  !named("output").length || !named("input").length ? "Say under Logs which channels are inputs and outputs." : "";

// ---- the stages ------------------------------------------------------------------------------------------------------------

const PANELS = {
  logs: {
    words: () => ["look", ...files("model"), ...files("held-out"), ...(S.channels.length && named("input").length && named("output").length ? roles([]) : []), ...stamps()],
    missing: () => (S.records.length ? "" : "Drop a log first."),
    go: "Look again",
    form: () => [dropped(), recordTable(), channelTable(), S.channels.length ? wanting() : null,
      el("div", {class: "fields"}, field("logs", "dt", "Sample time in s, of files without a time", S.chosen.dt ?? "", now => {
        const input = el("input", {type: "text", inputmode: "decimal"});
        input.value = now;
        input.addEventListener("change", () => choose(() => ({dt: input.value ? Number(input.value) : null})));
        return input;
      }))],
  },
  model: {
    words: () => ["identify", ...files("model"), ...roles(["--schedule", "none"]), "--model", value("model", "kind") || "all", ...stamps(), ...holdout()],
    missing,
    go: "Identify",
    form: () => [el("div", {class: "fields"}, select("model", "kind", "Models", [
      ["all", "all, side by side"], ["best", "the best on parts of the records"], ["lti", "LTI: without schedule"],
      ...(named("schedule").length ? [["ssm", "SSM: sparse, over the schedule"], ["ilm", "ILM: interpolated local models"], ["lpv-oe", "by free runs, over the schedule"]] : []),
      ["oe", "one or two poles and a dead time"], ["hammerstein", "static curves of the inputs"], ["interval", "interval model with a guaranteed envelope"],
    ]))],
  },
  machine: {
    words: () => ["effects", plantOf()],
    missing: () => (plantOf() ? "" : "Write an equation, guess one from the records, or choose a machine."),
    go: "Read it, and list what it can lack",
    form: () => [
      el("div", {class: "fields"}, plantChoice()),
      ...(S.chosen.plant && S.chosen.plant !== "plant.py:PLANT" ? [] : [editor("machine", "plant.py", "plant.py: your equation; the plant in it is called PLANT")]),
    ],
  },
  diagnosis: {
    words: () => [value("diagnosis", "verb") || "diagnose", ...files("model"), "--plant", plantOf(), ...stamps(), ...holdout()],
    missing: () => missing() || (plantOf() ? "" : "Choose or write a machine first."),
    go: "Diagnose",
    form: () => [el("div", {class: "fields"}, select("diagnosis", "verb", "What", [
      ["diagnose", "find what the equation lacks"], ["calibrate", "fit its parameters alone"]]))],
  },
  controller: {
    words: () => {
      const v = key => value("controller", key).trim();
      const kind = v("kind"), mpc = kind === "mpc";
      const option = (name, key) => (v(key) ? [name, v(key).replace(/\s+/g, "")] : []);
      return ["design", kind, "--model", v("model"), ...option("--setpoint", "setpoint"), ...option("--low", "low"), ...option("--high", "high"),
        ...(mpc ? ["--horizon", v("horizon")] : ["--sensitivity", v("ms"), "--complementary", v("mt"), "--effort", v("effort"), "--objective", v("objective")]),
        ...(kind === "scheduled-pid" ? ["--knots", v("knots")] : []), ...(mpc ? option("--keep", "keep") : [])];
    },
    missing: () => (made(MODELS).length ? "" : "Identify a model first."),
    go: "Design",
    form: () => {
      const models = newest(made(MODELS)), kinds = [["scheduled-pid", "scheduled PID"], ["pid", "PID, fixed gains"], ["mpc", "MPC"]];
      const start = named("schedule").length ? "scheduled-pid" : "pid";
      const inputs = named("input"), kind = value("controller", "kind") || start, mpc = kind === "mpc";
      const wanted = named("output").map(c => `${c.name}=${short(c.mean)}`).join(",");
      const ends = key => inputs.map(c => `${c.name}=${short(c[key])}`).join(",");
      return [el("div", {class: "fields"},
        select("controller", "kind", "Law", kinds, start), select("controller", "model", "Model", models.map(path => [path, path])),
        text("controller", "setpoint", "Usual set-point", wanted), text("controller", "low", "Lowest commands", ends("low")),
        text("controller", "high", "Highest commands", ends("high")),
        ...(mpc ? [range("controller", "horizon", "Samples ahead", 20, 5, 60, 1), text("controller", "keep", "Keep outputs between, y=low:high", "")] : [
          range("controller", "ms", "Largest |S|", 1.6, 1.2, 2.4, 0.05), range("controller", "mt", "Largest |T|", 1.6, 1.1, 2.4, 0.05),
          range("controller", "effort", "Largest effort", 3, 1.2, 20, 0.1),
          ...(kind === "scheduled-pid" ? [range("controller", "knots", "Knots of the schedule", 3, 2, 9, 1)] : []),
          select("controller", "objective", "Objective", [["variance", "least variance under noise and load"], ["integral", "most integral action"]])])),
        el("div", {id: "sketch", "aria-live": "polite"})];
    },
  },
  check: {
    words: () => {
      const v = key => value("check", key), plant = v("plant"), fitted = plant.includes("+") || plant.endsWith(".json") ? plant.replace(/.*\+/, "").replace(/[^/]*$/, "diagnosis.json") : "";
      return ["check", "--controller", v("controller"), "--limits", "limits.toml", ...(v("model") ? ["--model", v("model"), "--records", ...files("model")] : []),
        ...(plant ? ["--plant", plant] : []), ...(fitted && S.files.some(own => own.path === fitted) ? ["--fitted", fitted] : [])];
    },
    missing: () => (!made(["controller"]).length ? "Design a controller first." : S.texts["limits.toml"] === undefined ? "Say what the loop must keep: write limits.toml, or guess it from the records." :
      !value("check", "model") && !value("check", "plant") ? "Choose a model, a plant, or both." : ""),
    go: "Check",
    form: () => {
      const base = plantOf(), extended = newest(made(["plant"])).map(path => (base.includes(":") ? `${base}+${path}` : path));
      return [el("div", {class: "fields"},
        select("check", "controller", "Controller", newest(made(["controller"])).map(path => [path, path])),
        select("check", "model", "Prove on the model", [...newest(made(MODELS)).map(path => [path, path]), ["", "no model"]]),
        select("check", "plant", "Search for the worst machine on", [...extended.map(path => [path, `extended: ${path}`]), ...(base ? [[base, base]] : []), ["", "no plant"]],
          named("schedule").length && base.includes(":") ? "" : extended[0] ?? base)),
        editor("check", "limits.toml", "limits.toml: what the loop must keep")];
    },
  },
  export: {
    words: () => ["export", value("export", "controller"), "--to", value("export", "form")],
    missing: () => (made(["controller"]).length ? "" : "Design a controller first."),
    go: "Export",
    form: () => [el("div", {class: "fields"}, select("export", "controller", "Controller", newest(made(["controller"])).map(path => [path, path])),
      select("export", "form", "As", [["c", "C99"], ["st", "Structured Text (IEC 61131-3)"], ["csv", "gain tables (CSV)"], ["json", "JSON"]]))],
  },
};

function dropped() {
  const take = attempt(async taken => {
    for (const file of taken) {
      say(`${file.name} is on its way ...`);
      await ask(`/api/records/${encodeURIComponent(file.name)}`, "PUT", file);
    }
    say("");
    await refresh();
    if (taken.length) await begin(PANELS.logs.words());
  });
  const input = el("input", {type: "file", multiple: true, id: "pick", onchange: () => take([...input.files])});
  const over = on => event => { event.preventDefault(); place.classList.toggle("over", on); };
  const place = el("div", {class: "drop", ondragover: over(true), ondragleave: over(false), ondrop: event => { over(false)(event); take([...event.dataTransfer.files]); }},
    el("p", {}, "Drop logs here: text of any kind, Excel, MAT, Parquet, TDMS, MDF"), el("label", {for: "pick"}, "or choose them ", input));
  return place;
}

function recordTable() {
  if (!S.records.length) return null;
  const rows = S.records.map(own => {
    const use = el("select", {"aria-label": `use of ${own.name}`, onchange: () => choose(now => ({files: {...Object.fromEntries(S.records.map(r => [r.name, r.use])), ...now.files, [own.name]: use.value}}))},
      [["model", "models are made from it"], ["held-out", "held out, to score on"], ["none", "left out"]].map(([name, said]) => el("option", {value: name}, said)));
    use.value = own.use;
    const away = attempt(async () => { await ask(`/api/records/${encodeURIComponent(own.name)}`, "DELETE"); await refresh(); });
    return el("tr", {}, el("td", {}, own.name), el("td", {}, `${(own.size / 1024).toFixed(0)} KiB`), el("td", {}, use),
      el("td", {}, el("button", {class: "small", onclick: away, "aria-label": `remove ${own.name}`}, "Remove")));
  });
  return el("div", {class: "scroll"}, el("table", {}, el("thead", {}, el("tr", {}, ["Record", "Size", "Use", ""].map(head => el("th", {}, head)))), el("tbody", {}, rows)));
}

function channelTable() {
  if (!S.channels.length) return null;
  const rows = S.channels.map(channel => {
    const role = el("select", {"aria-label": `role of ${channel.name}`, onchange: () => choose(now => ({roles: {...now.roles, [channel.name]: role.value}}))},
      ["input", "output", "schedule", "reference", "other"].map(name => el("option", {value: name}, name)));
    role.value = roleOf(channel);
    return el("tr", {}, el("td", {}, channel.name), el("td", {}, channel.unit), el("td", {}, role), el("td", {}, `${short(channel.low)} to ${short(channel.high)}`), el("td", {}, channel.moves));
  });
  return el("div", {class: "scroll"}, el("table", {}, el("thead", {}, el("tr", {}, ["Channel", "Unit", "Role", "Range", "Moves"].map(head => el("th", {}, head)))), el("tbody", {}, rows)));
}

function wanting() {
  const lacking = ["input", "output"].filter(role => !named(role).length);
  return lacking.length ? el("p", {class: "outcome open"}, el("strong", {}, `Which channel is an ${lacking.join(", and which an ")}?`),
    " Say it under Role; what varies slowly and changes the machine is the schedule.") : null;
}

function plantChoice() {
  const input = el("select", {id: "plant", onchange: () => choose(() => ({plant: input.value}))},
    el("option", {value: "plant.py:PLANT"}, "an equation of my own (plant.py)"), S.machines.map(name => el("option", {value: name}, name)));
  input.value = S.chosen.plant || "plant.py:PLANT";
  return el("label", {for: "plant"}, "Machine", input);
}

function editor(stage, name, label) {
  const own = (fields[stage] ??= {}), there = S.texts[name] ?? "";
  if (!own[name] || own[name].untouched) own[name] = {value: there, untouched: true};
  const area = el("textarea", {id: `${stage}-text`, spellcheck: "false"});
  area.value = own[name].value;
  area.addEventListener("input", () => { own[name] = {value: area.value, untouched: false}; save.disabled = false; });
  const keep = attempt(async () => {
    await ask(`/api/texts/${name}`, "PUT", {text: area.value});
    own[name] = {value: area.value, untouched: true};
    save.disabled = true;
    await refresh();
  });
  const guess = attempt(async () => {
    if (there && !confirm(`Replace ${name} by a guess from the records?`)) return;
    await ask(`/api/texts/${name}`, "POST");
    delete own[name];
    drawn = "";
    await refresh();
  });
  const save = el("button", {onclick: keep, disabled: own[name].untouched}, "Save");
  return el("div", {}, el("label", {for: area.id}, label, area), el("div", {class: "row"}, save, el("button", {onclick: guess}, "Guess from the records")));
}

// ---- drawing ---------------------------------------------------------------------------------------------------------------

const current = () => STAGES.find(stage => stage.id === location.hash.slice(1)) ?? STAGES[0];
const ofStage = stage => S.steps.filter(step => stage.kinds.includes(step.kind));
const shown = stage => ofStage(stage).find(step => step.name === chosenRun) ?? ofStage(stage).at(-1);

function standing(step) {
  if (!step) return ["", ""];
  if (step.state === "running") return ["…", ""];
  if (step.state === "killed") return ["✗", "bad"];
  if (step.code === 0) return {open: ["?", "open"], bad: ["✗", "bad"]}[step.standing] ?? ["✓", "good"];
  return {1: step.kind === "check" ? ["✗", "bad"] : ["?", "open"], 3: ["?", "open"], 130: ["–", ""]}[step.code] ?? ["✗", "bad"];
}

function saidOf(step) {
  const lines = step.log.split("\n").filter(line => line.trim());
  if (step.state === "running") return ["Running", `${step.seconds.toFixed(0)} s; ${lines.at(-1)?.trim() ?? "beginning"}`];
  if (step.state === "killed") return ["Its process is gone", "It was killed from outside, or the machine went down. Run it again."];
  const spoken = lines.filter(line => !line.startsWith("  ") || line.startsWith("  mend")).filter(line => !/^(report|note|next experiment):/.test(line));
  if (step.code === 2) return ["Not done", spoken.join(" ").replace(/^workbench \w+: /, "")];
  if (step.code === 130) return ["Stopped", "What it had written is whole, the rest is not there."];
  if (step.code === 70) return ["An error of the workbench itself", spoken.join(" ")];
  const took = step.seconds === null ? "" : `in ${step.seconds.toFixed(0)} s`;
  const word = step.code === 0 ? (step.kind !== "check" ? "Done" : step.standing === "open" ? "Not decided" : "Kept") : step.code === 3 ? "Not handed out" : step.kind === "check" ? "Failed" : "The answer is no";
  return [word, step.page ? took : spoken[0] ?? ""];
}

function outcome(step) {
  const [, tone] = standing(step), [word, sentence] = saidOf(step), at = `${S.view}/${encodeURIComponent(step.name)}`;
  const own = S.files.filter(file => file.path.startsWith(`${step.name}/`));
  const box = el("section", {class: `outcome ${tone}`, "aria-live": "polite"}, el("strong", {id: "word"}, word), el("p", {id: "sentence", class: step.state === "running" ? "live" : ""}, sentence),
    el("div", {class: "row"}, step.state === "running" ? el("button", {onclick: () => stop(step.name)}, "Stop") : null,
      step.page ? el("a", {class: "button", id: "open", href: `${at}/report.html`, target: "_blank", rel: "noopener"}, "Open the page") : null));
  return [box,
    el("details", {}, el("summary", {}, "Command, Python and what it said"), el("pre", {}, step.command), step.python ? el("pre", {}, step.python) : null, el("pre", {id: "log"}, step.log)),
    own.length ? el("details", {open: step.kind === "export"}, el("summary", {}, "Files"), el("ul", {}, own.map(file =>
      el("li", {}, el("a", {href: `${S.view}/${file.path.split("/").map(encodeURIComponent).join("/")}`, download: file.path.split("/").at(-1)}, file.path))))) : null];
}

function preview() {
  const stage = current(), own = PANELS[stage.id], place = document.getElementById("preview"), go = document.getElementById("go");
  if (!place || !go) return;
  const lacking = own.missing();
  place.textContent = lacking || `workbench ${own.words().map(quoted).join(" ")}`;
  if (stage.id === "controller") sketch();
  go.disabled = Boolean(lacking) || S.steps.filter(step => step.state === "running").length > 1;
}
// ---- sketches: what a dragged bound makes of the last PID, at once ---------------------------------------------------------

let asking = false, asked = "";
async function sketch() {
  const place = document.getElementById("sketch"), v = key => Number(value("controller", key));
  if (!place || asking || value("controller", "kind") === "mpc") return;
  const model = value("controller", "model"), last = ofStage(current()).filter(step => step.state === "done" && step.code !== 2 && step.command.includes(model)).at(-1);
  const controller = last && made(["controller"]).find(path => path.startsWith(`${last.name}/`) && path.includes("pid"));
  if (!controller) return;
  const body = {controller, model, sensitivity: v("ms"), complementary: v("mt"), effort: v("effort")};
  if (JSON.stringify(body) === asked) return;
  asking = true;
  asked = JSON.stringify(body);
  try {
    draft(place, await ask("/api/sketch", "POST", body), body);
  } catch (reason) {
    place.replaceChildren(el("p", {class: "live"}, `No sketch: ${reason.message}`));
  }
  asking = false;
  sketch(); // a hand may have moved on
}

const SVG = "http://www.w3.org/2000/svg", W = 320, H = 220, PAD = 34;
function svg(name, own = {}, ...inside) {
  const node = document.createElementNS(SVG, name);
  for (const [key, text] of Object.entries(own)) node.setAttribute(key, text);
  node.append(...inside);
  return node;
}

/** A picture of lines over two axes; lines: {x, y, colour, dashed}. */
function picture(title, caption, lines, [x0, x1], [y0, y1], {more = () => [], ends = [short(x0), short(x1)]} = {}) {
  const X = x => PAD + (W - PAD - 8) * (x - x0) / (x1 - x0 || 1), Y = y => H - 24 - (H - 34) * (y - y0) / (y1 - y0 || 1);
  const path = line => svg("polyline", {fill: "none", stroke: line.colour, "stroke-width": 1.6, "stroke-dasharray": line.dashed ? "5 4" : "none",
    points: line.x.map((x, k) => `${X(x).toFixed(1)},${Y(line.y[k]).toFixed(1)}`).join(" ")});
  const label = (x, y, said, anchor) => { const node = svg("text", {x, y, "font-size": 11, fill: "var(--muted)", "text-anchor": anchor}); node.textContent = said; return node; };
  const frame = svg("rect", {x: PAD, y: 10, width: W - PAD - 8, height: H - 34, fill: "none", stroke: "var(--grid)"});
  const clip = svg("clipPath", {id: `clip-${title.length}`}, svg("rect", {x: PAD, y: 10, width: W - PAD - 8, height: H - 34}));
  const drawing = svg("g", {"clip-path": `url(#clip-${title.length})`}, ...more(X, Y), ...lines.map(path));
  return el("figure", {}, svg("svg", {viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": `${title}. ${caption}`}, clip, frame, drawing,
    label(PAD, H - 8, ends[0], "start"), label(W - 8, H - 8, ends[1], "end"), label(PAD - 4, H - 24, short(y0), "end"), label(PAD - 4, 20, short(y1), "end")),
    el("figcaption", {}, el("strong", {}, title), ` ${caption}`));
}

function draft(place, found, bounds) {
  const n = found.points.length, at = [...Array(n).keys()], colour = i => `var(--series-${1 + i % 6})`;
  const over = n > 1 ? at : [0, 1], flat = values => (n > 1 ? values : [values[0], values[0]]);
  const top = 1.15 * Math.max(bounds.sensitivity, bounds.complementary, ...found.sensitivity, ...found.complementary);
  const level = (y, c) => ({x: [over[0], over.at(-1)], y: [y, y], colour: c, dashed: true});
  const nyquist = found.loops.flatMap((each, i) => each[0].map((_, u) => ({x: each.map(own => own[u][0]), y: each.map(own => own[u][1]), colour: colour(i)})));
  const steps = found.steps.flatMap((each, i) => each.map(y => ({x: found.t, y, colour: colour(i)})));
  const high = 1.05 * Math.max(1.2, ...found.steps.flat(2).filter(Number.isFinite)), end = found.t.at(-1);
  const circle = (X, Y) => [svg("ellipse", {cx: X(-1), cy: Y(0), rx: Math.abs(X(1 / bounds.sensitivity) - X(0)), ry: Math.abs(Y(1 / bounds.sensitivity) - Y(0)), fill: "none", stroke: "var(--muted)"}),
    svg("circle", {cx: X(-1), cy: Y(0), r: 3, fill: "var(--ink)"})];
  const word = found.kept ? `Sketch: the gains of the last design times ${short(found.share)} keep these bounds at ${n} frozen loop${n > 1 ? "s" : ""}.` :
    "No common factor of the last design's gains keeps these bounds: it is drawn as it is.";
  place.replaceChildren(el("p", {class: "live", id: "sketched"}, `${word} Design weighs the gains anew.`), el("div", {class: "tuned"},
    picture("Margins", "largest |S| and |T| over the schedule; dashed: the bounds",
      [{x: over, y: flat(found.sensitivity), colour: colour(0)}, {x: over, y: flat(found.complementary), colour: colour(1)}, level(bounds.sensitivity, colour(0)), level(bounds.complementary, colour(1))], [over[0], over.at(-1)], [0, top], {ends: n > 1 ? [found.points[0], found.points.at(-1)] : ["", ""]}),
    picture("Nyquist curves", "of every command, the others closed; the circle is the bound on |S| about -1", nyquist, [-2.6, 1.2], [-1.5, 1.1], {more: circle}),
    picture("Steps", "of each set-point by 1, over seconds", steps, [0, end], [0, high])));
}

const quoted = word => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`);

function draw() {
  const stage = current(), own = PANELS[stage.id], step = shown(stage);
  const folder = document.getElementById("folder");
  folder.textContent = S.folder.split(/[\\/]/).at(-1);
  folder.title = S.folder;
  const marks = document.getElementById("stages"), runs = document.getElementById("runs");
  const link = (href, on, sign, tone, title, click) => el("li", {}, el("a", {href, class: tone, "aria-current": on ? "step" : null, onclick: click}, el("span", {class: "mark", "aria-hidden": "true"}, sign), title));
  replace(marks, STAGES.map(one => { const [sign, tone] = standing(ofStage(one).at(-1)); return link(`#${one.id}`, one === stage, sign || "·", tone, one.title, () => { chosenRun = null; }); }));
  replace(runs, [...S.steps].reverse().map(one => {
    const home = STAGES.find(other => other.kinds.includes(one.kind)), [sign, tone] = standing(one);
    return home ? link(`#${home.id}`, one === step, sign, tone, one.name, () => { chosenRun = one.name; drawn = ""; setTimeout(draw); }) :
      link(`${S.view}/${encodeURIComponent(one.name)}/report.html`, false, "·", "", one.name);
  }));

  // fields are drawn anew only where something else than a run's log has changed, and never under a typing hand
  const what = JSON.stringify([stage.id, S.chosen, S.records, S.channels, S.files.map(file => file.path), S.texts, value(stage.id, "kind")]);
  const typing = panel.contains(document.activeElement) && ["INPUT", "TEXTAREA"].includes(document.activeElement.tagName) && document.activeElement.type !== "range" && document.activeElement.type !== "file";
  if (!document.getElementById("form") || panel.dataset.stage !== stage.id || (what !== drawn && !typing)) {
    const focus = document.activeElement?.id;
    const form = el("div", {id: "form"}, el("h2", {}, stage.title), el("p", {class: "aim"}, stage.aim), ...own.form().filter(Boolean),
      el("pre", {id: "preview"}), el("div", {class: "row"}, el("button", {id: "go", class: "go", onclick: () => begin(own.words())}, own.go)));
    const frame = panel.dataset.stage === stage.id ? document.getElementById("result") : null;
    panel.replaceChildren(form, frame ?? el("div", {id: "result"}));
    if (panel.dataset.stage !== stage.id) window.scrollTo(0, 0);
    panel.dataset.stage = stage.id;
    drawn = what;
    asked = ""; // a sketch is drawn into the new fields
    if (focus) document.getElementById(focus)?.focus();
  }
  preview();
  result(step);
}

function result(step) {
  const place = document.getElementById("result");
  const state = step ? JSON.stringify([step.name, step.state, step.code, step.page]) : "";
  if (place.dataset.state === state) {
    if (step) {
      const [word, sentence] = saidOf(step);
      place.querySelector("#word").textContent = word;
      place.querySelector("#sentence").textContent = sentence;
      place.querySelector("#log").textContent = step.log;
    }
    return;
  }
  place.dataset.state = state;
  const page = step && step.state !== "running" && step.page;
  place.replaceChildren(...(step ? outcome(step).filter(Boolean) : []), ...(page ? [el("iframe", {
    src: `${S.view}/${encodeURIComponent(step.name)}/report.html`, title: `page of ${step.name}`, sandbox: "allow-scripts allow-popups allow-downloads"})] : []));
}

function replace(place, items) {
  const now = items.map(item => item.outerHTML).join("");
  if (place.dataset.now === now) return;
  place.dataset.now = now;
  place.replaceChildren(...items);
}

window.addEventListener("hashchange", () => { if (S) draw(); });
document.addEventListener("change", event => { if (event.target.id === "controller-kind") { drawn = ""; draw(); } });
refresh();
