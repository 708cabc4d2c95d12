// What a reader does with the page, in a real browser: node browser.mjs PUPPETEER BROWSER PAGE.
// Prints one JSON object; `problems` holds console errors, page errors and requests to elsewhere.
const [, , library, executablePath, page] = process.argv;
const { default: puppeteer } = await import(library);
const args = ["--no-sandbox", "--disable-gpu", "--single-process", "--no-zygote"];
const browser = await puppeteer.launch({ args, executablePath, headless: "shell" });

async function visit(width, scheme) {
  const tab = await browser.newPage();
  const problems = [];
  tab.on("console", (m) => ["error", "warn"].includes(m.type()) && problems.push(m.text()));
  tab.on("pageerror", (error) => problems.push(String(error)));
  tab.on("request", (r) => /^(file|data):/.test(r.url()) || problems.push(r.url()));
  tab.on("dialog", async (d) => { problems.push(`dialog ${d.message()}`); await d.dismiss(); });
  await tab.setViewport({ width, height: 800 });
  await tab.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
  await tab.goto(page);
  await tab.waitForSelector(".chart svg g path");
  const found = await tab.evaluate(() => {
    const table = [...document.querySelectorAll("table")].find((t) => t.tBodies[0].rows.length > 1);
    const cells = () => [...table.tBodies[0].rows].map((row) => parseFloat(row.cells[1].textContent));
    const button = table.tHead.rows[0].cells[1].querySelector("button");
    button.click();
    const rising = cells();
    button.click();
    const falling = cells();
    const viewer = document.querySelector(".viewer");
    const [, render, error] = viewer.querySelectorAll(".stage img");
    const slide = (value) => {
      const slider = viewer.querySelector("input");
      slider.value = value;
      slider.dispatchEvent(new Event("input"));
      return [render.style.clipPath, error.style.clipPath];
    };
    const method = viewer.querySelector('select[data-key="1"]'), before = render.src;
    method.selectedIndex = method.options.length - 1;
    method.dispatchEvent(new Event("change"));
    viewer.querySelector(".beside").click();
    const [one, two] = [...viewer.querySelectorAll(".pane")];
    const besides = !two.hidden && one.querySelector(".render").src !== two.querySelector(".render").src;
    const clipped = [...document.querySelectorAll(".scroll, figure")]
      .filter((part) => part.scrollWidth > part.clientWidth + 1).length;
    const shown = (selector) => [...document.querySelectorAll(selector)].filter((part) => getComputedStyle(part).display !== "none").length;
    const all = [shown("tbody tr"), shown("svg [data-method]")];
    const chip = [...document.querySelectorAll('[data-of="method"] button')].pop();
    chip.click();
    const fewer = [shown("tbody tr"), shown("svg [data-method]")];
    const link = document.querySelector("a.permalink").href;
    chip.click();
    const text = document.querySelector(".chart text"), ink = getComputedStyle(text).fill;
    return {
      besides, link, ink, all, fewer, clipped,
      rising, falling, start: slide(0), middle: slide(1.25), end: slide(2),
      changed: render.src !== before, loaded: render.naturalWidth > 0,
      overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
      again: [shown("tbody tr"), shown("svg [data-method]")],
      background: getComputedStyle(document.body).backgroundColor,
    };
  });
  await tab.goto("about:blank");
  await tab.goto(found.link);
  await tab.waitForSelector(".chart svg g path");
  const linked = await tab.evaluate(() => [
    [...document.querySelectorAll("tbody tr")].filter((row) => !row.hasAttribute("data-off")).length,
    document.querySelector('.pane select[data-key="1"]').value,
    document.querySelector(".pane[hidden]") === null,
  ]);
  await tab.goto("about:blank");
  await tab.goto(page);
  await tab.waitForSelector(".chart svg g path");
  await tab.emulateMediaType("print");
  await tab.setViewport({ width: 718, height: 1000 }); // A4 within its margins, at 96 dpi
  await new Promise((done) => setTimeout(done, 500));
  const printed = await tab.evaluate(() => [...document.querySelectorAll("table, svg, img, p")]
    .filter((part) => part.getBoundingClientRect().right > innerWidth + 1).length);
  await tab.close();
  return { ...found, linked, printed, problems };
}

const result = { wide: await visit(1280, "light"), phone: await visit(390, "dark") };
await browser.close();
console.log(JSON.stringify(result));
