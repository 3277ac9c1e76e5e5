// SPDX-License-Identifier: Apache-2.0
// Sentences and cells of tables that are longer, in words, than a reader takes in at once.
"use strict";

const { splitAST, SentenceSplitterSyntax } = require("sentence-splitter");

// Code counts as one word, as it is read as one.
const text = (node) => {
  if (node.type === "Code" || node.type === "InlineCode") return "code";
  return node.children ? node.children.map(text).join("") : (node.value ?? "");
};
const words = (node) => text(node).split(/\s+/).filter((word) => /\w/.test(word)).length;

const SENTENCE = 35;
const CELL = 25;

module.exports = ({ Syntax, RuleError, report }) => ({
  [Syntax.Paragraph](node) {
    for (const part of splitAST(node).children) {
      if (part.type === SentenceSplitterSyntax.Sentence && words(part) > SENTENCE) {
        report(part, new RuleError(`a sentence of ${words(part)} words: at most ${SENTENCE}`));
      }
    }
  },
  [Syntax.TableCell](node) {
    if (words(node) > CELL) report(node, new RuleError(`a table's cell of ${words(node)} words: at most ${CELL}; a list or text below holds more`));
  },
});
