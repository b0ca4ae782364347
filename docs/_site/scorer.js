// The order of the results of a search. Sphinx counts a word in any heading of a page as much as one in the page's title.
// Here a page whose title has the words of the question comes first; then recipes and tutorials; research and the changelog last.
const OF_QUESTIONS = new Set(
  ("a am an and any are as at be been by can could did do does for from get gets getting got had has have how i if in into is it its me my of " +
    "on or our shall should so some than that the their them then there these they this those to use was we were what when where which who " +
    "why will with would you your").split(" "),
);
var Scorer = {
  score: ([page, title, anchor, description, score, file, kind]) => {
    const question = new URLSearchParams(window.location.search).get("q") || "";
    const telling = (text) => (text.toLowerCase().match(/[a-z0-9_]+/g) || []).filter((word) => !OF_QUESTIONS.has(word));
    const words = telling(question);
    const isIn = (word) =>
      new RegExp(word.length < 4 ? `\\b${word}\\b` : `\\b${word.length > 5 ? word.slice(0, -2) : word}`, "i").test(title);
    const matched = words.filter(isIn).length;
    const share = words.length ? matched / words.length : 0;
    const closeness = matched / Math.max(matched, telling(title).length, 1); // of two titles, the shorter one comes first
    const folders = {
      "how-to/questions": anchor ? 19 : 8, "how-to/": 8, "install": 14, "tutorials/": 6, "explanation/": 5, "reference/": 3, "gallery/": 2, "reports/": 1, "project/security": 8,
      "reference/api/": -1, "reference/extend": -8, "project/": -10,
    };
    const folder = Object.keys(folders).filter((name) => page.startsWith(name)).sort((a, b) => b.length - a.length)[0];
    const overview = /(^|\/)index$|^reference\/api\/[^/]*$|-keys$/.test(page) ? -8 : 0;
    const member = kind === "object" && share < 1 ? -12 : 0;
    return score + 20 * share + 4 * closeness + (folder ? folders[folder] : 0) + overview + member;
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

// Sphinx finds only pages that have every word of a question, and no sections. Here a page that has most of the words is found
// too, further down, and so is a section whose heading has most of them. A word counts by its rarity. Unknown words do not count.
const MOST = 0.5;
const COST_OF_MISSING = 40;
const SCORE = 4; // its place in a result
const pagesWithAll = Search.performTermsSearch;
const scored = (result, score) => [...result.slice(0, SCORE), score, ...result.slice(SCORE + 1)];

function weighed(words, excluded) {
  const known = [...words].map((word) => ({ word, pages: pagesWithAll(new Set([word]), excluded) })).filter((each) => each.pages.length);
  const rarity = ({ pages }) => Math.log(1 + Search._index.docnames.length / pages.length);
  const whole = known.reduce((sum, each) => sum + rarity(each), 0);
  return known.map((each) => ({ ...each, weight: rarity(each) / whole }));
}

function pagesWithMost(words) {
  const results = new Map();
  for (const { pages, weight } of words) {
    for (const page of pages) {
      const before = results.get(page[0]) || { share: 0, score: 0 };
      results.set(page[0], { share: before.share + weight, score: Math.max(before.score, page[SCORE]), page });
    }
  }
  return [...results.values()].map(({ share, score, page }) => ({ share, result: scored(page, score) }));
}

function sectionsWithMost(words) {
  const { alltitles, docnames, filenames, titles } = Search._index;
  return Object.entries(alltitles).flatMap(([heading, places]) => {
    const stems = new Set(splitQuery(heading.toLowerCase()).map((word) => new Stemmer().stemWord(word)));
    const share = words.reduce((sum, { word, weight }) => sum + (stems.has(word) ? weight : 0), 0);
    return places.filter(([file, id]) => id !== null && titles[file] !== heading).map(([file, id]) => ({
      share,
      result: [docnames[file], `${titles[file]} > ${heading}`, `#${id}`, null, Scorer.title, filenames[file], SearchResultKind.title],
    }));
  });
}

Search.performTermsSearch = (words, excluded) => {
  const known = weighed(words, excluded);
  return [...pagesWithMost(known), ...sectionsWithMost(known)]
    .filter(({ share }) => share >= MOST)
    .map(({ share, result }) => scored(result, result[SCORE] - COST_OF_MISSING * (1 - share)));
};

// "why do I get NaN" asks for NaN. Words of questions count only if there are no others.
const parsed = Search._parseQuery;
Search._parseQuery = (query) => {
  const telling = splitQuery(query).filter((word) => !OF_QUESTIONS.has(word.toLowerCase()));
  return [query, ...parsed(telling.length ? telling.join(" ") : query).slice(1)];
};

// Sphinx shows the text about one of the words, which may stand in the path above the title. Here the passage with most of the words.
const PASSAGE = 240;
const BEFORE = 60; // characters shown before its first word

Search.htmlToText = (html, anchor) => {
  const page = new DOMParser().parseFromString(html, "text/html");
  page.querySelectorAll(".headerlink, script, style, nav").forEach((each) => each.remove());
  const part = (anchor && page.getElementById(anchor.slice(1))) || page.querySelector("article.bd-article, [role=main] article, [role=main]");
  part?.querySelector("h1, h2, h3, h4, h5, h6")?.remove(); // the title stands above the passage
  return (part?.textContent || "").replace(/\s+/g, " ").trim();
};

function placesOf(stem, text) {
  const beginning = stem.replace(/i$/, "").replace(/[.*+?^${}()|[\]\\]/g, "\\$&"); // the stem of "safety" is "safeti"
  return [...text.matchAll(new RegExp(`\\b${beginning}`, "gi"))].map(({ index }) => ({ stem, index }));
}

function bestStart(stems, text) {
  const places = stems.flatMap((stem) => placesOf(stem, text)).sort((a, b) => a.index - b.index);
  const most = { words: 0, index: 0 };
  for (const { index } of places) {
    const words = new Set(places.filter((each) => each.index >= index && each.index < index + PASSAGE - BEFORE).map(({ stem }) => stem)).size;
    if (words > most.words) Object.assign(most, { words, index });
  }
  return most.index <= BEFORE ? 0 : text.indexOf(" ", most.index - BEFORE) + 1;
}

Search.makeSearchSummary = (html, stems, anchor) => {
  const text = Search.htmlToText(html, anchor);
  if (!text) return null;
  const start = bestStart([...stems], text);
  const summary = document.createElement("p");
  summary.classList.add("context");
  summary.textContent = `${start ? "... " : ""}${text.slice(start, start + PASSAGE).trim()}${start + PASSAGE < text.length ? " ..." : ""}`;
  return summary;
};
