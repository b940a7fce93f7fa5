/* How the search ranks pages: tasks, tutorial and glossary come first. */
var Scorer = {
  score: (result) => result[4] + ({ how_do_i: 60, tutorial: 20, glossary: 20 }[result[0]] || (result[0].startsWith("guide/") ? 10 : 0)),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
