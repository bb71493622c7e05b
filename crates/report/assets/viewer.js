// The 3D view of a report: draws the scene of the page with three.js (`THREE`) and shows the values of clicked points.
//
// The scene is JSON with base64 arrays, written by crates/report/src/scene.rs. Nothing is loaded from the network.
"use strict";
(() => {
  const holder = document.getElementById("view");
  const data = document.getElementById("scene");
  if (!holder || !data) return;
  const scene = JSON.parse(data.textContent);

  // ---- arrays -------------------------------------------------------------------------------------------------------
  const ARRAYS = { f32: Float32Array, u32: Uint32Array, u16: Uint16Array, u8: Uint8Array };
  function array(packed) {
    let bytes;
    if (Uint8Array.fromBase64) bytes = Uint8Array.fromBase64(packed.data);
    else {
      const text = atob(packed.data);
      bytes = new Uint8Array(text.length);
      for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    }
    return new ARRAYS[packed.type](bytes.buffer);
  }
  // Quantised positions: steps of 1/65535 of the bounding box.
  function places(packed) {
    const raw = array(packed);
    if (packed.type === "f32") return raw;
    const out = new Float32Array(raw.length);
    const [low, high] = scene.steps;
    for (let k = 0; k < raw.length; k++) out[k] = low[k % 3] + (raw[k] / 65535) * (high[k % 3] - low[k % 3]);
    return out;
  }

  // ---- colours ------------------------------------------------------------------------------------------------------
  // Maps, ranges, ticks and the colours of kinds come with the scene, as crates/report/src/colour.rs makes them.
  const ofHex = (h) => [0, 2, 4].map((k) => parseInt(h.slice(k, k + 2), 16) / 255);
  const MAPS = Object.fromEntries(Object.entries(scene.maps).map(([name, colours]) => [name, colours.map(ofHex)]));
  const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  function ramp(map, place) {
    const at = Math.min(Math.max(place, 0), 1) * 16;
    const k = Math.min(Math.floor(at), 15);
    return [0, 1, 2].map((c) => map[k][c] + (at - k) * (map[k + 1][c] - map[k][c]));
  }
  const css = (c) => `rgb(${c.map((x) => Math.round(255 * x)).join(",")})`;
  const UNKNOWN = [0.6, 0.6, 0.6];

  function number(value, digits = 4) {
    if (!Number.isFinite(value)) return "unknown";
    if (value === 0) return "0";
    const size = Math.abs(value);
    if (size >= 1e6 || size < 1e-4) {
      const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
      const raised = [...exponent.replace("+", "")].map((c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[c])).join("");
      return `${Number(mantissa)}·10${raised}`;
    }
    return String(Number(value.toPrecision(digits)));
  }
  // The colour scale of a field: { colour(value), legend }.
  function scale(field) {
    if (field.categories) {
      const colours = new Map(field.categories.map(([value, , hex]) => [value, ofHex(hex)]));
      return { colour: (value) => colours.get(value) || UNKNOWN, categories: field.categories.map(([, label, hex]) => ({ colour: `#${hex}`, label })) };
    }
    if (field.colours) return { colour: (v) => (Number.isFinite(v) ? [v >> 16, (v >> 8) & 255, v & 255].map((c) => c / 255) : UNKNOWN) };
    const { low, high, logarithmic, ticks } = field.range;
    const map = MAPS[field.range.map];
    const place = logarithmic ? (v) => Math.log(Math.max(v, 0) / low) / Math.log(high / low) : (v) => (v - low) / (high - low);
    return { colour: (v) => (Number.isFinite(place(v)) ? ramp(map, place(v)) : UNKNOWN), map, ticks };
  }
  function paint(geometry, field) {
    const n = geometry.getAttribute("position").count;
    const colours = geometry.getAttribute("color")?.array || new Float32Array(3 * n);
    const { colour } = field ? field.scale : { colour: () => [0.72, 0.74, 0.77] };
    for (let k = 0; k < n; k++) {
      const c = colour(field ? field.array[k] : 0);
      for (let d = 0; d < 3; d++) colours[3 * k + d] = linear(c[d]);
    }
    if (geometry.getAttribute("color")) geometry.getAttribute("color").needsUpdate = true;
    else geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  }

  // ---- the scene ----------------------------------------------------------------------------------------------------
  // Software rendering is slow, so it uses one sample per pixel.
  function drawnInSoftware() {
    const gl = document.createElement("canvas").getContext("webgl2");
    const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
    const name = gl ? String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER)) : "";
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    return /swiftshader|llvmpipe|software|basic render/i.test(name);
  }
  const software = drawnInSoftware();
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: !software, preserveDrawingBuffer: true, alpha: true });
  } catch {
    holder.querySelector(".nothing").hidden = false;
    // The box shrinks to the text, and the caption would explain controls that do not exist.
    holder.closest("figure").classList.add("unavailable");
    return;
  }
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "3D view. Drag or use the arrow keys to rotate, scroll or press + and − to zoom, click a point to see its values.");
  holder.prepend(canvas);
  renderer.setPixelRatio(software ? 1 : Math.min(window.devicePixelRatio || 1, 2));
  renderer.setClearColor(0x000000, 0);
  const world = new THREE.Scene();
  const middle = new THREE.Vector3(...[0, 1, 2].map((d) => (scene.low[d] + scene.high[d]) / 2));
  const size = Math.hypot(...[0, 1, 2].map((d) => scene.high[d] - scene.low[d])) || 1;
  const camera = new THREE.PerspectiveCamera(28, 1, size / 200, size * 30);
  camera.up.set(...scene.up);
  world.add(new THREE.HemisphereLight(0xffffff, 0xb8bcc4, 1.5));
  const lamp = new THREE.DirectionalLight(0xffffff, 1.7);
  world.add(lamp, lamp.target);
  let controls;
  // The controls read the up direction only when they are created.
  function rebuild() {
    controls?.dispose();
    controls = new THREE.OrbitControls(camera, canvas);
    controls.target.copy(middle);
    controls.enableDamping = false;
    controls.addEventListener("change", redraw);
  }
  const knife = new THREE.Plane(new THREE.Vector3(-1, 0, 0), 0);

  const surfaces = scene.surfaces.map((given) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places(given.positions), 3));
    geometry.setIndex(new THREE.BufferAttribute(array(given.triangles), 1));
    geometry.computeVertexNormals();
    const fields = given.fields.map((field) => {
      const made = { ...field, array: array(field.values) };
      made.scale = scale(made);
      return made;
    });
    const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide, flatShading: given.flat });
    // Lines and dots on the surface are seen.
    material.polygonOffset = true;
    material.polygonOffsetFactor = 1;
    material.polygonOffsetUnits = 2;
    if (given.translucent) { material.transparent = true; material.opacity = 0.35; material.depthWrite = false; }
    const mesh = new THREE.Mesh(geometry, material);
    mesh.userData = { given, fields };
    if (given.sets) mesh.userData.sets = array(given.sets.of_vertex);
    mesh.visible = !given.hidden;
    paint(geometry, null);
    world.add(mesh);
    return mesh;
  });
  const clouds = scene.clouds.map((given) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places(given.positions), 3));
    const fields = given.fields.map((field) => {
      const made = { ...field, array: array(field.values) };
      made.scale = scale(made);
      return made;
    });
    const points = new THREE.Points(geometry, new THREE.PointsMaterial({ vertexColors: true, size: given.width || 3, sizeAttenuation: false }));
    points.userData = { given, fields, field: fields[0] };
    points.visible = !given.hidden;
    paint(geometry, fields[0]);
    world.add(points);
    return points;
  });
  const lines = scene.lines.map((given) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places(given.positions), 3));
    const drawn = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: given.colour || "#222222", transparent: true, opacity: given.opacity || 0.55 }));
    drawn.userData = { given };
    drawn.visible = !given.hidden;
    world.add(drawn);
    return drawn;
  });
  const marks = scene.marks.map((mark, k) => {
    const ball = new THREE.Mesh(new THREE.SphereGeometry(0.009 * size, 20, 14), new THREE.MeshLambertMaterial({ color: "#d55e00" }));
    ball.position.set(...mark.at);
    ball.userData = { mark, k };
    const label = document.createElement("span");
    label.className = "mark";
    label.textContent = mark.label;
    label.title = mark.text;
    holder.append(label);
    world.add(ball);
    return { ball, label };
  });
  const pin = new THREE.Mesh(new THREE.SphereGeometry(0.006 * size, 20, 14), new THREE.MeshBasicMaterial({ color: "#e6007e" }));
  pin.visible = false;
  world.add(pin);
  const all = [...surfaces, ...clouds, ...lines];

  // ---- drawing: only when something changed ------------------------------------------------------------------------
  let wanted = false;
  const towards = new THREE.Vector3();
  function draw() {
    wanted = false;
    camera.getWorldDirection(towards);
    // The light comes from the upper left, behind the camera.
    const right = new THREE.Vector3().crossVectors(towards, camera.up).normalize();
    lamp.position.copy(camera.position).addScaledVector(right, -0.35 * size).addScaledVector(camera.up, 0.5 * size);
    lamp.target.position.copy(controls.target);
    renderer.render(world, camera);
    for (const { ball, label } of marks) {
      const at = ball.position.clone().project(camera);
      const off = camera.position.clone().sub(ball.position);
      label.classList.toggle("behind", off.dot(new THREE.Vector3(...ball.userData.mark.normal)) < 0);
      label.hidden = !ball.visible || Math.abs(at.x) > 1 || Math.abs(at.y) > 1;
      label.style.left = `${(50 * (at.x + 1)).toFixed(2)}%`;
      label.style.top = `${(50 * (1 - at.y)).toFixed(2)}%`;
    }
  }
  function redraw() {
    if (!wanted) {
      wanted = true;
      requestAnimationFrame(draw);
    }
  }
  rebuild();
  const from = new THREE.Vector3(...scene.from).normalize();
  // A sample of the positions that must fit into the view.
  const outline = [];
  for (const mesh of surfaces.length ? surfaces : [...clouds, ...lines]) {
    const places = mesh.geometry.getAttribute("position");
    for (let k = 0; k < places.count; k += Math.max(1, Math.floor(places.count / 600))) outline.push(new THREE.Vector3().fromBufferAttribute(places, k));
  }
  // Looks at the centre from a direction, at a distance from which everything is visible.
  function look(direction = from) {
    const forward = direction.clone().normalize().negate();
    const right = new THREE.Vector3().crossVectors(forward, camera.up).normalize();
    const upwards = new THREE.Vector3().crossVectors(right, forward);
    const high = Math.tan((camera.fov * Math.PI) / 360);
    const wide = high * camera.aspect;
    let far = size / 20;
    for (const place of outline) {
      const off = place.clone().sub(middle);
      const along = off.dot(forward);
      far = Math.max(far, Math.abs(off.dot(right)) / wide - along, Math.abs(off.dot(upwards)) / high - along);
    }
    controls.target.copy(middle);
    camera.position.copy(middle).addScaledVector(forward, -1.12 * far);
    controls.update();
    redraw();
  }
  function resize() {
    const { clientWidth: width, clientHeight: height } = holder;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    const before = camera.aspect;
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (Math.min(1, before) !== Math.min(1, camera.aspect)) look(camera.position.clone().sub(controls.target).normalize());
    redraw();
  }
  new ResizeObserver(resize).observe(holder);

  // ---- controls beside the view --------------------------------------------------------------------------------------
  const panel = document.getElementById("tools");
  const legend = document.getElementById("legend");
  const main = surfaces.find((mesh) => mesh.visible && mesh.userData.fields.length) || surfaces[0];
  const offered = main ? main.userData.fields : clouds[0] ? clouds[0].userData.fields : [];
  const element = (tag, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  };
  function tell(field) {
    legend.replaceChildren();
    if (!field) return;
    const [shownUnit] = field.shown || [field.unit];
    const unit = shownUnit ? ` / ${shownUnit}` : "";
    legend.append(element("div", { className: "legend-title" }, `${field.label}${unit}`));
    const { map, ticks, categories } = field.scale;
    if (categories) {
      const list = element("ul", {});
      for (const { colour, label } of categories.slice(0, 12)) {
        const dot = element("i", {});
        dot.style.background = colour;
        list.append(element("li", {}, dot, label));
      }
      if (categories.length > 12) list.append(element("li", {}, `${categories.length - 12} more`));
      legend.append(list);
    } else if (map) {
      const bar = element("div", { className: "bar" });
      bar.style.background = `linear-gradient(to right, ${map.map(css).join(",")})`;
      const axis = element("div", { className: "axis" });
      for (const [place, label] of ticks) {
        const tick = element("span", {}, label);
        tick.style.left = `${100 * place}%`;
        tick.style.transform = `translateX(${place < 0.08 ? 0 : place > 0.92 ? -100 : -50}%)`;
        axis.append(tick);
      }
      legend.append(bar, axis);
    }
  }
  let shown = null;
  function colourBy(key) {
    let chosen = null;
    for (const mesh of surfaces) {
      const field = mesh.userData.fields.find((f) => f.key === key) || null;
      paint(mesh.geometry, field);
      if (field && (!chosen || mesh === main)) chosen = field;
    }
    if (!main)
      for (const cloud of clouds) {
        const field = cloud.userData.fields.find((f) => f.key === key);
        if (field) paint(cloud.geometry, field), (chosen = chosen || field);
      }
    shown = key;
    tell(chosen);
    redraw();
  }
  if (offered.length) {
    const select = element("select", { id: "colour" });
    for (const field of offered) select.append(element("option", { value: field.key }, field.label));
    select.onchange = () => colourBy(select.value);
    panel.append(element("label", { className: "pick" }, element("span", {}, "Colour"), select));
  }
  const boxes = element("div", { className: "boxes" });
  function box(label, checked, change) {
    const input = element("input", { type: "checkbox", checked });
    input.onchange = () => {
      change(input.checked);
      redraw();
    };
    boxes.append(element("label", {}, input, label));
  }
  const named = (list) => list.length + clouds.length + lines.length > 1 || list.length > 1;
  for (const thing of all) {
    const { given } = thing.userData;
    // A single surface needs no name, unless it was thinned: the name then states by how much.
    if (thing === main && !named(surfaces) && !given.thinned) continue;
    box(given.name, thing.visible, (on) => {
      thing.visible = on;
      if (on && clouds.includes(thing) && main && thing.userData.field) tell(thing.userData.field);
      else if (shown) colourBy(shown);
    });
  }
  if (marks.length) box(scene.marks_name || "points", true, (on) => marks.forEach(({ ball }) => (ball.visible = on)));
  panel.append(boxes);
  // The cut.
  const axis = element("select", { "ariaLabel": "Cut across" });
  for (const [value, label] of [["", "no cut"], ["0", "across x"], ["1", "across y"], ["2", "across z"], ["-1", "across the view"]])
    axis.append(element("option", { value }, label));
  const depth = element("input", { type: "range", min: 0, max: 1000, value: 500, disabled: true, ariaLabel: "Position of the cut" });
  function cut() {
    const on = axis.value !== "";
    depth.disabled = !on;
    if (on) {
      const normal = axis.value === "-1" ? camera.position.clone().sub(controls.target).normalize().negate() : new THREE.Vector3().setComponent(Number(axis.value), -1);
      const place = middle.clone().addScaledVector(normal, size * (0.5 - depth.value / 1000));
      if (axis.value !== "-1") {
        const d = Number(axis.value);
        place.setComponent(d, scene.low[d] + (scene.high[d] - scene.low[d]) * (depth.value / 1000));
      }
      knife.setFromNormalAndCoplanarPoint(normal, place);
    }
    renderer.clippingPlanes = on ? [knife] : [];
    redraw();
  }
  axis.onchange = cut;
  depth.oninput = cut;
  panel.append(element("label", { className: "pick" }, element("span", {}, "Cut"), axis, depth));
  // What is up.
  const up = element("select", {});
  for (const [value, label] of [["0,0,1", "z"], ["0,1,0", "y"], ["1,0,0", "x"], ["0,0,-1", "−z"], ["0,-1,0", "−y"], ["-1,0,0", "−x"]])
    up.append(element("option", { value, selected: value === scene.up.join(",") }, label));
  up.onchange = () => {
    camera.up.set(...up.value.split(",").map(Number));
    const turned = from.clone();
    const d = camera.up.toArray().findIndex((c) => c !== 0);
    if (d < 2) turned.set(...(d === 1 ? [from.x, from.z, -from.y] : [from.z, from.x, from.y]));
    if (camera.up.getComponent(d) < 0) turned.negate();
    rebuild();
    look(turned);
  };
  panel.append(element("label", { className: "pick" }, element("span", {}, "Up"), up));
  const home = element("button", { type: "button", title: "Return to the initial view (Home)" }, "Reset view");
  home.onclick = () => look();
  panel.append(home);

  // ---- reading a point ------------------------------------------------------------------------------------------------
  const reading = document.getElementById("reading");
  const caster = new THREE.Raycaster();
  const cutAway = (p) => renderer.clippingPlanes.length > 0 && knife.distanceToPoint(p) < 0;
  function nearest(hit) {
    const { a, b, c } = hit.face;
    const positions = hit.object.geometry.getAttribute("position");
    let best = a;
    let least = Infinity;
    for (const k of [a, b, c]) {
      const d = new THREE.Vector3().fromBufferAttribute(positions, k).distanceToSquared(hit.point);
      if (d < least) [best, least] = [k, d];
    }
    return best;
  }
  function valueText(field, value) {
    if (field.categories) {
      const found = field.categories.find(([v]) => v === value);
      return found ? found[1] : "–";
    }
    if (field.colours) return Number.isFinite(value) ? [value >> 16, (value >> 8) & 255, value & 255].join(", ") : "unknown";
    const [unit, factor] = field.shown || [field.unit, 1];
    return `${number(factor * value, 6)}${Number.isFinite(value) && unit ? ` ${unit}` : ""}`;
  }
  function read(x, y) {
    const frame = canvas.getBoundingClientRect();
    caster.setFromCamera(new THREE.Vector2((2 * (x - frame.left)) / frame.width - 1, 1 - (2 * (y - frame.top)) / frame.height), camera);
    caster.params.Points.threshold = 0.006 * size;
    const things = [...surfaces.filter((m) => !m.userData.given.translucent), ...clouds].filter((o) => o.visible);
    const balls = marks.filter(({ ball }) => ball.visible).map(({ ball }) => ball);
    const hit = caster.intersectObjects([...balls, ...things], false).find((h) => h.object.userData.mark || !cutAway(h.point));
    if (!hit) {
      pin.visible = false;
      reading.hidden = true;
      redraw();
      return null;
    }
    const rows = [];
    const result = { values: {} };
    let title = "";
    if (hit.object.userData.mark) {
      const { mark } = hit.object.userData;
      title = `${scene.marks_name || "measure here"}: ${mark.label}`;
      rows.push(["", mark.text]);
      pin.position.set(...mark.at);
    } else {
      const k = hit.index ?? nearest(hit);
      const { given, fields, sets } = hit.object.userData;
      pin.position.fromBufferAttribute(hit.object.geometry.getAttribute("position"), k);
      title = given.name;
      for (const field of fields) {
        rows.push([field.label, valueText(field, field.array[k])]);
        result.values[field.key] = field.array[k];
      }
      if (sets) {
        const names = given.sets.sets[sets[k]].map((s) => given.sets.names[s]);
        rows.push(["scans", names.length ? names.join(", ") : "none"]);
        result.seen_by = names;
      }
      result.vertex = k;
      result.surface = given.name;
    }
    const at = [0, 1, 2].map((d) => scene.centre[d] + pin.position.getComponent(d));
    result.position = at;
    rows.unshift(["position", `${at.map((c) => number(c, 6)).join(", ")} ${scene.unit}`]);
    reading.replaceChildren(element("h3", {}, title), ...rows.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
    reading.hidden = false;
    pin.visible = true;
    redraw();
    return result;
  }
  let pressed = null;
  canvas.addEventListener("pointerdown", (e) => (pressed = [e.clientX, e.clientY]));
  canvas.addEventListener("pointerup", (e) => {
    if (pressed && Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) < 5) read(e.clientX, e.clientY);
    pressed = null;
  });
  // Keys: arrows rotate, + and − zoom, Home resets the view.
  function turn(across, upwards) {
    const off = camera.position.clone().sub(controls.target);
    off.applyAxisAngle(camera.up, across);
    const side = new THREE.Vector3().crossVectors(off, camera.up).normalize();
    const next = off.clone().applyAxisAngle(side, upwards);
    if (Math.abs(next.clone().normalize().dot(camera.up)) < 0.995) off.copy(next);
    camera.position.copy(controls.target).add(off);
    controls.update();
    redraw();
  }
  const closer = (factor) => {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    redraw();
  };
  const keys = { ArrowLeft: () => turn(-0.12, 0), ArrowRight: () => turn(0.12, 0), ArrowUp: () => turn(0, 0.12), ArrowDown: () => turn(0, -0.12), "+": () => closer(0.9), "=": () => closer(0.9), "-": () => closer(1.11), Home: () => look(), Escape: () => { pin.visible = false; reading.hidden = true; redraw(); } };
  canvas.addEventListener("keydown", (e) => {
    if (keys[e.key]) {
      keys[e.key]();
      e.preventDefault();
    }
  });

  resize();
  look();
  if (offered.length) colourBy(offered[0].key);
  draw();
  holder.classList.add("drawn");
  // For tests: clicks and frame rate.
  window.planish = {
    read,
    colourBy,
    look: (x, y, z) => look(new THREE.Vector3(x, y, z).normalize()),
    framesPerSecond(frames) {
      const pixel = new Uint8Array(4);
      const gl = renderer.getContext();
      const begun = performance.now();
      for (let k = 0; k < frames; k++) {
        turn(0.05, 0);
        draw();
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      }
      return (1000 * frames) / (performance.now() - begun);
    },
  };
})();
