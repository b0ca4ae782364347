// The order of the results of a search. Sphinx counts a word in any heading of a page as much as one in the page's title.
// Here a page whose title has the words of the question comes first; then recipes and tutorials; research and the changelog last.
var Scorer = {
  score: ([page, title, anchor, description, score, file, kind]) => {
    const question = new URLSearchParams(window.location.search).get("q") || "";
    const ignored = /^(a|an|and|are|as|at|by|can|do|does|for|from|have|how|i|in|is|it|me|my|of|on|or|the|to|use|what|when|why|with)$/;
    const words = (question.toLowerCase().match(/[a-z0-9_]+/g) || []).filter((word) => !ignored.test(word));
    const isIn = (word) =>
      new RegExp(word.length < 4 ? `\\b${word}\\b` : `\\b${word.length > 5 ? word.slice(0, -2) : word}`, "i").test(title);
    const share = words.length ? words.filter(isIn).length / words.length : 0;
    const folders = {
      "how-to/questions": 19, "how-to/": 8, "install": 14, "tutorials/": 6, "explanation/": 5, "reference/": 3, "gallery/": 2, "reports/": 1,
      "reference/api/": -1, "reference/extend": -8, "project/": -10,
    };
    const folder = Object.keys(folders).filter((name) => page.startsWith(name)).sort((a, b) => b.length - a.length)[0];
    const overview = /(^|\/)index$|^reference\/api\/[^/]*$|-keys$/.test(page) ? -8 : 0;
    const member = kind === "object" && share < 1 ? -12 : 0;
    return score + 20 * share + (folder ? folders[folder] : 0) + overview + member;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
