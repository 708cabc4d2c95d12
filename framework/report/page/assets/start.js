document.querySelectorAll("table").forEach(setUpTable);
document.querySelectorAll(".chart").forEach(setUpChart);
document.querySelectorAll(".forest").forEach(setUpForest);
document.querySelectorAll(".viewer").forEach(setUpViewer);
document.querySelectorAll(".filter").forEach(setUpFilter);
