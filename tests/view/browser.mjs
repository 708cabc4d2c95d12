// What a reader does with the page of a run, or of two, in a real browser without a graphics card:
// node browser.mjs PUPPETEER BROWSER PAGE. Prints one JSON object by visit; `problems` holds console
// errors, page errors and requests to elsewhere, `pictures` the first run's from every camera.
const [, , library, executablePath, page] = process.argv;
const { default: puppeteer } = await import(library);
const quiet = ["--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"];
const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", ...quiet];
const browser = await puppeteer.launch({ args, executablePath, headless: true, protocolTimeout: 240000 });
const rest = (ms) => new Promise((done) => setTimeout(done, ms));

async function visit(width, height, scheme, touch) {
  const tab = await browser.newPage();
  const problems = [];
  tab.on("console", (m) => ["error", "warn"].includes(m.type()) && problems.push(m.text()));
  tab.on("pageerror", (error) => problems.push(String(error)));
  tab.on("request", (r) => r.url() === page || /^(data|blob):/.test(r.url()) || problems.push(r.url()));
  tab.on("dialog", async (d) => { problems.push(`dialog ${d.message()}`); await d.dismiss(); });
  await tab.setViewport({ width, height, isMobile: touch, hasTouch: touch });
  await tab.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }, { name: "prefers-reduced-motion", value: "reduce" }]);
  await tab.goto(page);
  await tab.waitForFunction(() => document.documentElement.dataset.ready || document.querySelector("#status.bad"), { timeout: 120000 });
  const status = () => tab.evaluate(() => document.getElementById("status").textContent);
  const pose = () => tab.evaluate(() => JSON.stringify(window.fishersplat.eye.pose));
  const settled = () => tab.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done()))));
  const press = async (key) => { await tab.keyboard.press(key); await settled(); };
  const found = { problems, ready: await tab.evaluate(() => Number(document.documentElement.dataset.ready)), first: await status() };
  found.background = await tab.evaluate(() => getComputedStyle(document.body).backgroundColor);
  found.overflow = await tab.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  found.fits = await tab.evaluate(() => [...document.querySelectorAll("nav button, nav select")].every((b) => {
    const box = b.getBoundingClientRect();
    return !box.width || (box.left >= 0 && box.right <= innerWidth && box.bottom <= innerHeight);
  }));
  found.stage = await tab.evaluate(() => document.getElementById("stage").clientHeight / innerHeight);

  await press("p");
  found.photo = await tab.evaluate(() => {
    const photo = document.getElementById("photo");
    return !photo.hidden && getComputedStyle(document.getElementById("seam")).display !== "none";
  });
  found.loaded = await tab.evaluate(() => document.getElementById("photo").decode().then(() => document.getElementById("photo").naturalWidth));
  found.clips = [];
  for (const value of [0, 100]) {
    found.clips.push(await tab.evaluate((v) => {
      const slider = document.getElementById("slider");
      slider.value = v;
      slider.dispatchEvent(new Event("input"));
      return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(Number(document.getElementById("photo").style.clipPath.match(/[\d.]+/g).pop())))));
    }, value));
  }
  await press(".");
  found.second = await status();
  await press(",");
  found.again = await status();
  await press("b");
  found.beside = await tab.evaluate(() => document.getElementById("slider").hidden && !document.getElementById("photo").hidden);
  await press("b");

  const before = await pose(), [x, y] = [width / 2, height / 3];
  if (touch) {
    const client = await tab.createCDPSession();
    const send = (type, ...points) => client.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([px, py], id) => ({ x: px, y: py, id })) });
    await send("touchStart", [x, y]);
    for (const k of [1, 2, 3]) await send("touchMove", [x + 20 * k, y]);
    await send("touchEnd");
    found.turned = (await pose()) !== before;
    const far = await tab.evaluate(() => window.fishersplat.eye.distance);
    await send("touchStart", [x - 20, y], [x + 20, y]);
    for (const k of [1, 2, 3]) await send("touchMove", [x - 20 - 15 * k, y], [x + 20 + 15 * k, y]);
    await send("touchEnd");
    found.closer = (await tab.evaluate(() => window.fishersplat.eye.distance)) < far;
  } else {
    await tab.mouse.move(x, y);
    await tab.mouse.down();
    await tab.mouse.move(x + 60, y + 20, { steps: 4 });
    await tab.mouse.up();
    found.turned = (await pose()) !== before;
    const far = await tab.evaluate(() => window.fishersplat.eye.distance);
    await tab.mouse.wheel({ deltaY: -300 });
    await rest(100);
    await settled();
    found.closer = (await tab.evaluate(() => window.fishersplat.eye.distance)) < far;
  }
  await settled();
  found.hidden = await tab.evaluate(() => document.getElementById("photo").hidden);
  const standing = await pose();
  await tab.keyboard.down("w");
  await rest(100);
  await settled();
  await tab.keyboard.up("w");
  found.flown = (await pose()) !== standing;
  await press("h");
  found.home = (await pose()) === before;
  for (const key of ["2", "3", "1", "c", "f", "?"]) await press(key);
  found.help = await tab.evaluate(() => document.getElementById("help").open);
  found.names = await tab.evaluate(() => window.fishersplat.cameras);
  found.pictures = await tab.evaluate((runs) => window.fishersplat.cameras.map((_, i) => runs.map((run) => {
    const { width, height, data } = window.fishersplat.picture(i, run);
    return [width, height, btoa(String.fromCharCode(...data))];
  })), touch ? [] : [0, ...(await tab.evaluate(() => document.getElementById("splats1") ? [1] : []))]);
  await tab.close();
  return found;
}

const told = { wide: await visit(1100, 700, "light", false), phone: await visit(390, 780, "dark", true) };
console.log(JSON.stringify(told));
await browser.close();
