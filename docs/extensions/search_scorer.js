// Weights of the site's search: pages that answer come before lists, logs and generated pages.
const FOLDERS = [
  ["howto/index", -6],
  ["howto/", 8],
  ["start/", 5],
  ["tutorials/", 3],
  ["quality/", 2],
  ["reference/api/generated/", -2],
  ["reference/commands/", -2],
  ["gallery/", -6],
  ["development/", -8],
  ["architecture", -8],
  ["benchmarks", -6],
  ["accuracy", -3],
];

// Words of the question without their endings, so that "refocusing" finds "refocus".
const ASKED = (new URLSearchParams(window.location.search).get("q") || "")
  .toLowerCase()
  .split(/[^\p{L}\p{N}.]+/u)
  .filter((word) => word.length > 2)
  .map((word) => word.slice(0, 6));

var Scorer = {
  score: ([page, title, , , score]) => {
    const words = title.toLowerCase();
    const named = ASKED.filter((word) => words.includes(word)).length;
    const folder = FOLDERS.find(([start]) => page.startsWith(start));
    return score + (folder ? folder[1] : 0) + (12 * named) / Math.max(ASKED.length, 1);
  },

  // As Sphinx has them.
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
