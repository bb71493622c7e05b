// Opens the reports of all jobs in a headless Chromium: see README.md.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import puppeteer from "puppeteer-core";

const here = dirname(fileURLToPath(import.meta.url));
const data = join(here, "../../examples/data");
const planish = process.env.PLANISH || join(here, "../../target/release/planish");
const out = join(here, "out");
mkdirSync(out, { recursive: true });
const at = (name) => join(out, name);
const run = (...words) => execFileSync(planish, [...words, "--quiet"], { stdio: ["ignore", "inherit", "inherit"] });

// ---- the reports ----
run("fit", join(data, "pebble/job.toml"), "-o", at("pebble.ply"), "-o", at("pebble.planish"), "--mesh-tolerance", "0.05", "--report", at("fit.html"));
run("compare", at("pebble.planish"), join(data, "pebble/truth.ply"), "--report", at("compare.html"));
run("next", at("pebble.planish"), "--count", "6", "--report", at("next.html"));
run("merge", join(data, "pebble/truth.ply"), at("pebble.ply"), "--report", at("merge.html"));
run("simulate", "scene", "readings", "--shape", "rectangle", "--readings", "300", "--out", at("readings"));
run("contour", at("readings/readings.csv"), "--constrain", "--report", at("contour.html"));
run("solid", ...["front", "top", "side"].map((view) => join(data, `bracket/${view}.dxf`)), "--report", at("solid.html"));

run("solid", ...["front", "top"].map((view) => join(data, `bracket/${view}.dxf`)), "--all", "--report", at("solids.html"));
run("next", at("pebble.planish"), "--views", "3", "--sensor", join(data, "camera.toml"), "--report", at("views.html"));
run("simulate", "sphere", "--sets", "2", "--readings", "50", "--depth", "1", "-o", at("sphere.svg"), "--report", at("sphere.html"));
// Points over a ball that is longer in x, for a shape in space and for a mesh to be moved.
const over = (radius, longer) =>
  Array.from({ length: 600 }, (_, k) => {
    const z = 1 - (2 * (k + 0.5)) / 600;
    const r = Math.sqrt(1 - z * z);
    return [longer * r * Math.cos(2.399963 * k), r * Math.sin(2.399963 * k), z].map((c) => radius * c);
  });
writeFileSync(at("ball.csv"), `x,y,z,sigma\n${over(20, 1).map((p) => `${p.join(",")},0.01\n`).join("")}`);
run("contour", at("ball.csv"), "--kind", "sphere", "--report", at("shape.html"));
writeFileSync(at("longer.xyz"), over(40, 1.15).map((p) => `${p.join(" ")}\n`).join(""));
run("shell", "fit", join(data, "pebble/truth.ply"), "--points", at("longer.xyz"), "--controls", "30", "--report", at("shell.html"));
run("view", at("pebble.planish"), "-o", at("view.html"));
run("view", join(data, "pebble/job.toml"), "-o", at("scans.html"));

// ---- positions and σ of a binary PLY ----
function vertices(path) {
  const bytes = readFileSync(path);
  const end = bytes.indexOf("end_header\n") + "end_header\n".length;
  const header = bytes.subarray(0, end).toString("latin1").split("\n");
  assert(header.includes("format binary_little_endian 1.0"));
  const sizes = { char: 1, uchar: 1, int8: 1, uint8: 1, short: 2, ushort: 2, int: 4, uint: 4, float: 4, float32: 4, double: 8, float64: 8 };
  let count = 0;
  let stride = 0;
  const places = {};
  let inside = false;
  for (const line of header) {
    const words = line.split(" ");
    if (words[0] === "element") {
      inside = words[1] === "vertex";
      if (inside) count = Number(words[2]);
    } else if (words[0] === "property" && inside) {
      places[words[2]] = [stride, words[1]];
      stride += sizes[words[1]];
    }
  }
  const number = (k, name) => {
    const [offset, type] = places[name];
    const from = end + k * stride + offset;
    return type.startsWith("d") || type === "float64" ? bytes.readDoubleLE(from) : bytes.readFloatLE(from);
  };
  return Array.from({ length: count }, (_, k) => ({ at: ["x", "y", "z"].map((name) => number(k, name)), sigma: number(k, "sigma") }));
}

// ---- the pages ----
const browser = await puppeteer.launch({
  executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const sizes = { desktop: { width: 1280, height: 800 }, phone: { width: 390, height: 844, deviceScaleFactor: 2, isMobile: true, hasTouch: true } };
const extra = process.argv.slice(2).map((path) => [path, path.split("/").pop()]);
const pages = [...["fit", "compare", "next", "merge", "contour", "solid", "solids", "views", "sphere", "shape", "shell", "view", "scans"].map((job) => [at(`${job}.html`), `${job}.html`]), ...extra];
for (const [path, name] of pages) {
  for (const [screen, viewport] of Object.entries(sizes)) {
    const page = await browser.newPage();
    await page.setViewport(viewport);
    const wrong = [];
    page.on("console", (message) => ["error", "warn", "warning"].includes(message.type()) && wrong.push(message.text()));
    page.on("pageerror", (error) => wrong.push(error.message));
    page.on("request", (request) => /^(file|data|blob):/.test(request.url()) || wrong.push(`asks for ${request.url()}`));
    const begun = performance.now();
    await page.goto(pathToFileURL(path).href);
    const has3d = (await page.$("#view")) !== null;
    if (has3d) await page.waitForSelector("#view.drawn", { timeout: 20000 });
    const opened = Math.round(performance.now() - begun);
    let speed = "";
    if (has3d) {
      // Not blank: colours differ over the canvas.
      const colours = await page.evaluate(() => {
        const canvas = document.querySelector("#view canvas");
        const small = Object.assign(document.createElement("canvas"), { width: 64, height: 64 });
        const context = small.getContext("2d");
        context.drawImage(canvas, 0, 0, 64, 64);
        const { data } = context.getImageData(0, 0, 64, 64);
        return new Set(Array.from({ length: 64 * 64 }, (_, k) => data.slice(4 * k, 4 * k + 4).join())).size;
      });
      assert(colours > 20, `${name}: ${colours} colours on the canvas`);
      if (screen === "desktop") speed = `, ${(await page.evaluate(() => window.planish.framesPerSecond(30))).toFixed(1)} pictures a second`;
    } else assert(await page.$("figure.drawing svg path, figure.drawing svg polyline"), `${name}: no drawing`);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    assert(wide <= 0, `${name}: ${wide} pixels wider than the ${screen}`);
    if (name === "fit.html" && screen === "desktop") {
      const frame = await (await page.$("#view canvas")).boundingBox();
      const file = vertices(at("pebble.ply"));
      for (const [x, y] of [[0.5, 0.5], [0.42, 0.6], [0.6, 0.42]]) {
        await page.mouse.click(frame.x + x * frame.width, frame.y + y * frame.height);
        assert(await page.$eval("#reading", (r) => !r.hidden && r.textContent.includes("σ along the normal")), "a click reads nothing");
        const read = await page.evaluate((px, py) => window.planish.read(px, py), frame.x + x * frame.width, frame.y + y * frame.height);
        const off = (v) => Math.hypot(...v.at.map((c, d) => c - read.position[d]));
        const nearest = file.reduce((best, v) => (off(v) < off(best) ? v : best));
        assert(off(nearest) < 1e-4, `no vertex of the file at ${read.position}`);
        assert.equal(read.values.sigma, Math.fround(nearest.sigma));
      }
    }
    await page.screenshot({ path: at(`${name.replace(".html", "")}-${screen}.png`) });
    assert.deepEqual(wrong, [], name);
    console.log(`${name} on a ${screen}: opened in ${opened} ms${speed}`);
    await page.close();
  }
}

// ---- the page of the server ----
const server = spawn(planish, ["view", at("pebble.planish"), "--no-open"], { stdio: ["ignore", "ignore", "pipe"] });
const ended = new Promise((resolve) => server.on("exit", resolve));
const url = await new Promise((resolve, reject) => {
  let text = "";
  server.stderr.on("data", (part) => {
    text += part;
    const found = text.match(/http:\/\/\S+/);
    if (found) resolve(found[0]);
  });
  ended.then(() => reject(new Error(`no address: ${text}`)));
});
const page = await browser.newPage();
const wrong = [];
page.on("console", (message) => wrong.push(message.text()));
page.on("pageerror", (error) => wrong.push(error.message));
page.on("request", (request) => request.url() === url || /^(data|blob):/.test(request.url()) || wrong.push(`asks for ${request.url()}`));
assert.equal((await page.goto(url)).status(), 200);
await page.waitForSelector("#view.drawn", { timeout: 20000 });
assert.deepEqual(wrong, [], url);
// Scripts that are not the page's own do not run: neither elements nor attributes.
const injected = await page.evaluate(() => {
  document.body.append(Object.assign(document.createElement("script"), { textContent: "window.injected = 1" }));
  const button = document.createElement("button");
  button.setAttribute("onclick", "window.injected = 2");
  document.body.append(button);
  button.click();
  return window.injected;
});
assert.equal(injected, undefined);
assert.equal((await page.goto(url.slice(0, -1))).status(), 404);
await browser.close();
server.kill("SIGINT");
assert.equal(await ended, 0);
console.log("The served page works, and runs no other scripts.");
console.log("All is well.");
