// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/syntax_words.hpp"

#include <array>

namespace slamgw {
namespace {

/// The first row whose fragments are all in the message gives the words.
struct Row {
  std::string_view fragment;
  std::string_view second;  // empty: no second condition
  std::string_view words;
};

constexpr std::array rows = {
    Row{"invalid string", "U+000A",
        "a text does not end on its line; close it with a double quote"},
    Row{"invalid string", "missing closing quote",
        "a text does not end; close it with a double quote"},
    Row{"invalid string", "UTF-8", "a text is not UTF-8; save the file as UTF-8"},
    Row{"invalid string", "backslash",
        "a text holds an unknown backslash sequence; write a backslash itself as \\\\"},
    Row{"invalid string", "",
        "a text holds a control character or a broken \\u sequence; escape it"},
    Row{"invalid comment", "", "a broken comment; comments are // to the line's end, or /* ... */"},
    Row{"invalid number", "", "a broken number; allowed are numbers like 5, -5 and 1.5"},
    Row{"number overflow", "", "a number is too large; allowed are numbers below 1e308"},
    Row{"invalid literal", "object key", "a key without quotes; write it in double quotes"},
    Row{"invalid literal", "",
        "this is no JSON value; allowed are \"text\", numbers, true, false, null, [...] and {...}"},
    Row{"invalid BOM", "", "the file starts with a broken byte order mark; save the file as UTF-8"},
    Row{"unexpected end of input", "while parsing value",
        "the file ends where a value should stand; an empty configuration is {}"},
    Row{"empty input", "", "the file is empty; an empty configuration is {}"},  // Debian 13
    Row{"unexpected end of input", "",
        "the file ends too early; close every { with } and every [ with ]"},
    Row{"unexpected '}'", "object key", "a comma before }; remove the comma"},
    Row{"unexpected ']'", "while parsing value",
        "a ] where a value should stand; remove the comma before it"},
    Row{"unexpected '}'", "while parsing value",
        "a } where a value should stand; write a value after the colon"},
    Row{"unexpected ','", "while parsing value", "a comma where a value should stand; remove one"},
    Row{"unexpected ','", "object key", "a comma too many; remove one"},
    Row{"", "object key", "something else where a key should stand; write it in double quotes"},
    Row{"", "object separator", "no colon after a key; write \"key\": value"},
    Row{"expected end of input", "", "text after the end of the configuration; remove it"},
    Row{"while parsing object", "", "a comma is missing before this, or a } is; add it"},
    Row{"while parsing array", "", "a comma is missing before this, or a ] is; add it"},
};

bool has(std::string_view message, std::string_view fragment) {
  return message.find(fragment) != std::string_view::npos;
}

}  // namespace

std::string syntax_words(std::string_view message) {
  // "...; last read: '<text of the file>'; expected ...": our rows must not match the file's text.
  std::string reason(message.substr(0, message.find("last read:")));
  if (const std::size_t expected = message.rfind("; expected "); expected != message.npos)
    reason += message.substr(expected);
  for (const Row& row : rows)
    if (has(reason, row.fragment) && has(reason, row.second)) return std::string(row.words);
  return "this is not JSON; compare with the output of slam-gatewayd --print-config";
}

}  // namespace slamgw
