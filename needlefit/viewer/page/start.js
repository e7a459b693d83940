/** The one script of a file: the page, or in a worker what computes bands. */

if (typeof document === "undefined") import("./model/band_worker.js");
else import("./main.js");
