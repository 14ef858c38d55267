"use strict";

// Milliseconds.
const STATE_EVERY = 200, PICTURE_EVERY = 100, STALE = 2000;
// A picture may take its time over a slow link; a state that late is asked for again.
const STATE_WITHIN = 3000, PICTURE_WITHIN = 9000;
const LEVELS = { none: "No alert", traffic: "Traffic", caution: "Caution", warning: "Warning" };
const URGENCY = Object.keys(LEVELS);
const LINKS = { up: "up", silent: "no answer", down: "down" };
const STATES = { starting: "starting", watching: "watching", blind: "blind", camera_gone: "camera gone", slow: "too slow" };

const $ = (id) => document.getElementById(id);
const sleep = (time) => new Promise((wake) => setTimeout(wake, time));
const seconds = (time) => `${Math.floor(time / 1000)} s`;

// The last answer, and when it came; nothing yet.
let state = null, heard = performance.now(), refused = false;
let pictured = null, tag = "";

// The token comes with the address once, and is out of sight from then on.
const given = new URLSearchParams(location.search).get("token");
if (given !== null) {
  sessionStorage.setItem("token", given);
  history.replaceState(null, "", location.pathname);
}

// The answer with its content as `read` takes it; null where there is none: the age of what is shown tells that.
async function ask(path, headers, within, read) {
  const token = sessionStorage.getItem("token");
  if (token) headers.Authorization = `Bearer ${token}`;
  try {
    const answer = await fetch(path, { headers, cache: "no-store", signal: AbortSignal.timeout(within) });
    refused = answer.status === 401;
    return answer.status === 200 ? { headers: answer.headers, content: await read(answer) } : null;
  } catch {
    return null;
  }
}

// Asks again and again, one question at a time: a slow link gets fewer answers, none of them late.
async function repeat(every, question) {
  for (;;) {
    const start = performance.now();
    try {
      if (!refused) await question();
    } catch (error) {
      console.error(error);
    }
    await sleep(Math.max(start + every - performance.now(), 20));
  }
}

async function askState() {
  const answer = await ask("state.json", {}, STATE_WITHIN, (answer) => answer.json());
  if (answer) {
    state = answer.content;
    heard = performance.now();
  }
  show();
}

async function askPicture() {
  if (document.hidden || !state) return;
  const known = tag ? { "If-None-Match": tag } : {};
  const answer = await ask("frame.jpg", known, PICTURE_WITHIN, (answer) => answer.blob());
  if (!answer) return;
  const bitmap = await createImageBitmap(answer.content);
  tag = answer.headers.get("ETag");
  pictured = performance.now();
  const canvas = $("picture");
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  bitmap.close();
  showBoxes(JSON.parse(answer.headers.get("Lookout-Tracks")), canvas);
}

// Elements that stay as they are are left alone: a reader of the screen says what changes.
function say(id, text) {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
}

function make(name, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// Text that stays on one line.
function span(text) {
  const element = document.createElement("span");
  element.textContent = text;
  return element;
}

function chip(level, text) {
  const element = span(text);
  element.className = "chip";
  element.dataset.level = level;
  return element;
}

function rows(id, list) {
  const body = $(id).tBodies[0];
  body.replaceChildren(...list.map((cells) => {
    const row = document.createElement("tr");
    cells.forEach((cell, i) => {
      const element = row.insertCell();
      element.className = $(id).tHead.rows[0].cells[i].className;
      element.append(...[cell].flat());
    });
    return row;
  }));
}

// What is not known, or no number, comes as null.
const number = (value, digits, unit) => value === null ? "–" : `${value.toFixed(digits)}${unit}`;
const digits = (range) => range !== null && range < 10 ? 1 : 0;
const metres = (range) => number(range, digits(range), " m");
// The range with its standard deviation, as it comes from an assumed wingspan.
const distance = ({ range_m: range, range_sigma_m: sigma }) =>
  range === null || sigma === null || sigma === undefined ? metres(range)
    : `${range.toFixed(digits(range))} ± ${number(sigma, digits(range), " m")}`;
const label = (track) => track.callsign || String(track.id);
const name = (track) => track.callsign || `Object ${track.id}`;
const side = (angle, positive, negative) =>
  angle === null ? "–" : `${number(Math.abs(angle), 1, "°")} ${angle < 0 ? negative : positive}`;
const bearing = (track) =>
  [side(track.azimuth_deg, "right", "left"), side(track.elevation_deg, "up", "down")];
const urgent = (a, b) => URGENCY.indexOf(b.level) - URGENCY.indexOf(a.level)
  || (a.time_to_contact_s ?? Infinity) - (b.time_to_contact_s ?? Infinity) || a.id - b.id;

function inWords(track) {
  const parts = [`${name(track)}: ${bearing(track).join(", ")}`];
  if (track.range_m !== null) parts.push(`about ${distance(track)}`);
  if (track.time_to_contact_s !== null) parts.push(`contact in ${number(track.time_to_contact_s, 1, " s")}`);
  return parts.join(", ");
}

// What is wrong, in words, and whether what is shown is still true.
function fault() {
  const silent = performance.now() - heard;
  if (refused) return { old: true, text: sessionStorage.getItem("token") ? "Wrong token." : "This page asks for a token." };
  if (silent > STALE) {
    const shown = state ? "What is shown is old." : "Nothing was heard yet.";
    return { old: true, text: `No connection for ${seconds(silent)}. ${shown}` };
  }
  if (!state) return null;
  const { age_ms, health } = state;
  if (health.state === "starting") return { old: false, text: "Starting: no frame yet." };
  if (age_ms + silent > STALE) {
    return { old: true, text: `The lookout stands still: nothing new for ${seconds(age_ms + silent)}.` };
  }
  if (health.state === "camera_gone") return { old: false, text: "Camera gone: no pictures come." };
  if (health.state === "slow") {
    return { old: false, text: sentence(health.advice ?? "the detector is too slow for these frames") };
  }
  if (health.state === "blind" || health.blind.length) {
    return { old: false, text: `Blind: ${health.blind.join(", ") || "nothing can be seen"}.` };
  }
  if (state.autopilot_lost) {
    return { old: false, watching: true, text: "Autopilot lost: no traffic is on its map or that of a ground station." };
  }
  if (!state.autopilot && state.links.length) {
    return { old: false, watching: true, text: "No autopilot heard: no traffic is on its map or that of a ground station." };
  }
  if (state.off_map) {
    return { old: false, watching: true, text: `Traffic is not on the map: ${state.off_map}.` };
  }
  if (health.advice) return { old: false, watching: true, text: sentence(health.advice) };
  return null;
}

const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;

function showAlert() {
  const trouble = fault();
  const tracks = state ? [...state.tracks].sort(urgent) : [];
  let level = state?.level ?? "unknown";
  let word = LEVELS[level] ?? "Connecting";
  let detail = tracks.length ? inWords(tracks[0]) : state ? "No object followed." : "";
  if (trouble?.old) [level, word, detail] = ["unknown", "Unknown", ""];
  // No object is no good news where nothing can be seen.
  else if (trouble && !trouble.watching && level === "none") [level, word, detail] = ["unknown", "Not watching", ""];
  $("banner").dataset.level = level;
  say("level", word);
  say("detail", detail);
  $("fault").hidden = !trouble;
  say("fault", trouble?.text ?? "");
  $("all").classList.toggle("old", Boolean(trouble?.old));
  $("all").hidden = refused;
  $("key").hidden = !refused;
  const title = `${word} – Lookout`;
  if (document.title !== title) document.title = title;
  const age = pictured === null ? null : performance.now() - pictured;
  say("caption", age === null ? "No picture yet" : age > STALE ? `No new picture for ${seconds(age)}` : "");
}

function show() {
  showAlert();
  if (!state) return;
  const { tracks, health, latency, links } = state;
  rows("objects", [...tracks].sort(urgent).map((track) => [
    [label(track), chip(track.level, track.muted ? "own fleet" : track.level === "none" ? "followed" : track.level)],
    [span(`${bearing(track)[0]},`), " ", span(bearing(track)[1])],
    // Breaks before the error where the column is narrow.
    distance(track).split(/ (?=±)/).flatMap((part, i) => i ? [" ", span(part)] : [span(part)]),
    span(number(track.time_to_contact_s, 1, " s")),
    number(track.score, 2, ""),
  ]));
  $("objects").hidden = !tracks.length;
  $("nothing").hidden = Boolean(tracks.length);
  say("state", STATES[health.state]);
  say("camera", health.camera || "–");
  say("frames", `${health.frames} seen, ${health.dropped} dropped`);
  say("rate", number(health.frames_per_second, 1, " frames a second"));
  showAutopilot();
  rows("latency", latency.map((l) => [l.stage, span(number(l.p50_ms, 1, " ms")), span(number(l.p99_ms, 1, " ms"))]));
  rows("links", links.map((l) => [l.name, chip(l.state, LINKS[l.state]), String(l.sent), String(l.dropped)]));
  rows("parameters", state.parameters.map((p) => [p.name, span(short(p.value)), span(`${short(p.range[0])} to ${short(p.range[1])}`)]));
  $("parameters-card").hidden = !state.parameters.length;
  showMap();
}

// As few digits as give the same single-precision number.
function short(value) {
  for (let digits = 1; digits < 9; digits++) {
    const text = Number(value.toPrecision(digits));
    if (Math.fround(text) === Math.fround(value)) return String(text);
  }
  return String(value);
}

// A missing autopilot stands out.
function showAutopilot() {
  const { autopilot, autopilot_lost: lost } = state;
  const [level, word] = lost ? ["lost", "lost"] : autopilot ? ["", ""] : ["none_heard", "none heard"];
  const text = `${autopilot ?? ""}${word}`;
  const element = $("autopilot");
  if (element.dataset.text === text) return;
  element.dataset.text = text;
  element.replaceChildren(...(autopilot ? [autopilot] : []), ...(word ? [chip(level, word)] : []));
}

// Puts a text at the first of these places where it is within `bounds` and on no other text; the last one else. Places
// are left and top of the text.
function place(text, places, bounds, taken) {
  const { x, y, width, height } = text.getBBox();
  const [dx, dy] = [Number(text.getAttribute("x")) - x, Number(text.getAttribute("y")) - y];
  const clear = (a) => taken.every((b) =>
    a.x >= b.x + b.width || b.x >= a.x + a.width || a.y >= b.y + b.height || b.y >= a.y + a.height);
  const within = (value, start, end) => Math.min(Math.max(value, start), Math.max(start, end));
  const boxes = places(width, height).map(([left, top]) => ({
    x: within(left, bounds.x, bounds.x + bounds.width - width),
    y: within(top, bounds.y, bounds.y + bounds.height - height),
    width,
    height,
  }));
  const box = boxes.find(clear) ?? boxes.at(-1);
  taken.push(box);
  text.setAttribute("x", box.x + dx);
  text.setAttribute("y", box.y + dy);
}

// Outlines around the boxes, in pixels of the picture; the objects are those of this very picture.
function showBoxes(tracks, { width, height, clientWidth }) {
  const pixel = width / Math.max(clientWidth, 1);
  const svg = $("boxes");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const groups = new Map(tracks.map((track) => {
    const [left, top, w, h] = track.rect;
    const gap = 4 * pixel;
    const box = { x: left - gap, y: top - gap, width: w + 2 * gap, height: h + 2 * gap };
    const words = track.level === "none" ? label(track) : `${label(track)} ${track.level}`;
    const [ids, size] = [{ "data-level": track.level, "data-id": track.id }, 13 * pixel];
    const text = make("text", { x: 0, y: 0, "font-size": size, ...ids }, words);
    const group = make("g", ids, make("rect", { class: "edge", ...box }), make("rect", { class: "line", ...box }));
    if (track.coasting || !track.confirmed) group.classList.add("foretold");
    return [track, { group, box, text }];
  }));
  // Labels over all outlines.
  const drawn = [...groups.values()];
  svg.replaceChildren(...drawn.map(({ group }) => group), ...drawn.map(({ text }) => text));
  const taken = [], bounds = { x: 0, y: 0, width, height };
  for (const track of [...tracks].sort(urgent)) {
    const { box, text } = groups.get(track);
    // Above, below, beside, then line by line away from the box.
    place(text, (wide, high) => {
      const [above, below] = [box.y - high, box.y + box.height];
      const lines = [...Array(24).keys()].flatMap((i) => [[box.x, above - i * high], [box.x, below + i * high]]);
      return [...lines.slice(0, 2), [box.x + box.width, box.y], [box.x - wide, box.y], ...lines.slice(2)];
    }, bounds, taken);
  }
}

// The more urgent, the more corners.
const MARKS = {
  none: "M-3,0a3,3 0 1 0 6,0a3,3 0 1 0 -6,0z",
  traffic: "M-4.5,0a4.5,4.5 0 1 0 9,0a4.5,4.5 0 1 0 -9,0z",
  caution: "M0,-6.5L6.5,0L0,6.5L-6.5,0z",
  warning: "M0,-8L7.5,5.5L-7.5,5.5z",
};
const RANGES = [50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000];

// The vehicle in the middle, its nose upward; angles clockwise from there.
function showMap() {
  const { tracks, camera_azimuth_deg: middle, field_of_view_deg: view } = state;
  const at = (angle, radius) => {
    const radians = angle * Math.PI / 180;
    return [Math.sin(radians) * radius, -Math.cos(radians) * radius];
  };
  const farthest = Math.max(0, ...tracks.map((track) => track.range_m ?? 0));
  const known = tracks.some((track) => track.range_m !== null);
  const limit = RANGES.find((range) => range >= farthest) ?? farthest;
  const half = Math.min(view, 359.9) / 2;
  const [from, to] = [at(middle - half, 100), at(middle + half, 100)];
  const wedge = `M0,0L${from}A100,100 0 ${half > 90 ? 1 : 0} 1 ${to}z`;
  const word = (angle, radius, text) => {
    const [x, y] = at(angle, radius);
    return make("text", { x, y }, text);
  };
  const seen = tracks.filter((track) => track.azimuth_deg !== null);
  const marks = seen.sort(urgent).reverse().map((track) => {
    const far = track.range_m === null;
    const radius = far ? 100 : Math.min(track.range_m / limit, 1) * 100;
    const [x, y] = at(track.azimuth_deg, radius);
    return make("g", { class: far ? "track far" : "track", "data-level": track.level, "data-id": track.id },
      make("line", { class: "ray", x1: 0, y1: 0, x2: x, y2: y }),
      make("path", { class: "mark", d: MARKS[track.level], transform: `translate(${x} ${y})` }));
  });
  const names = new Map(seen.map((track, i) =>
    [marks[i], make("text", { x: 0, y: 0, class: "id", "data-id": track.id }, label(track))]));
  $("map").replaceChildren(
    make("path", { class: "view", d: wedge }),
    make("circle", { class: "ring", r: 50 }),
    make("circle", { class: "ring", r: 100 }),
    ...[["nose", 0], ["right", 90], ["tail", 180], ["left", -90]].map(([text, angle]) => word(angle, 114, text)),
    ...(known ? [word(135, 50, metres(limit / 2)), word(135, 100, metres(limit))] : []),
    make("path", { class: "own", d: "M0,-8L6,7L0,4L-6,7z" }),
    ...marks,
    ...names.values(),
  );
  const taken = [], bounds = { x: -124, y: -124, width: 248, height: 248 };
  // The most urgent, which is drawn last, has the first choice.
  marks.reverse().forEach((mark) => {
    const { x, y, width, height } = mark.querySelector(".mark").getBBox();
    const [cx, cy] = mark.querySelector(".mark").getAttribute("transform").match(/-?[\d.]+(e-?\d+)?/g).map(Number);
    const [left, top] = [cx + x, cy + y];
    place(names.get(mark), (wide, high) => [0, 1, 2, 3].flatMap((i) => [
      [left + width + 2, cy - high / 2 + i * high],
      [left - wide - 2, cy - high / 2 - i * high],
      [cx - wide / 2, top - high * (i + 1)],
      [cx - wide / 2, top + height + high * i],
    ]), bounds, taken);
  });
}

$("key").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("token", $("token").value.trim());
  refused = false;
  heard = performance.now();
});
setInterval(showAlert, 250);
repeat(STATE_EVERY, askState);
repeat(PICTURE_EVERY, askPicture);
