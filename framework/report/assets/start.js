/* a long table takes screens of a telephone; on paper everything is open */
const folded = document.querySelectorAll("details.long");
if (matchMedia("(max-width: 44rem)").matches) folded.forEach((one) => { one.open = false; });
addEventListener("beforeprint", () => folded.forEach((one) => { one.open = true; }));

document.querySelectorAll("table").forEach(setUpTable);
document.querySelectorAll(".viewer").forEach(setUpViewer);
document.querySelectorAll(".filter").forEach(setUpFilter);
recall();
addEventListener("hashchange", recall);
