// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/located_json.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <iterator>
#include <map>
#include <utility>

namespace slamgw {

namespace {

/// The first row whose fragments are all in the message supplies the words.
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
        "this is not a JSON value; allowed are \"text\", numbers, true, false, null, [...] and "
        "{...}"},
    Row{"invalid BOM", "", "the file starts with a broken byte order mark; save the file as UTF-8"},
    Row{"unexpected end of input", "while parsing value",
        "the file ends where a value should stand; an empty configuration is {}"},
    Row{"empty input", "", "the file is empty; an empty configuration is {}"},  // Debian 13
    Row{"unexpected end of input", "",
        "the file ends too early; close every { with } and every [ with ]"},
    Row{"unexpected '}'", "object key", "a comma before }; remove the comma"},
    Row{"unexpected ']'", "while parsing value",
        "a ] where a value should stand; remove the comma before it"},
    Row{"unexpected '}'", "expected end of input",
        "a } after the end of the configuration; remove it"},
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
  // Curly quotes, which word processors write, begin with this octet, as many characters do.
  if (has(message, "invalid literal") && has(message, "\xe2'"))
    return "a curly quote or another special character; write straight quotes, \"";
  // "...; last read: '<text of the file>'; expected ...": our rows must not match the file's text.
  std::string reason(message.substr(0, message.find("last read:")));
  if (const std::size_t expected = message.rfind("; expected "); expected != message.npos)
    reason += message.substr(expected);
  for (const Row& row : rows)
    if (has(reason, row.fragment) && has(reason, row.second)) return std::string(row.words);
  return "this is not JSON; compare with the output of slam-gatewayd --print-config";
}

namespace {

constexpr std::size_t max_depth = 16;  // the configuration needs 4

/// Input for the lexer; records the line of the last character read. The lexer also reads the
/// character after a number, which is still on the number's line.
class LineIterator {
 public:
  using iterator_category = std::input_iterator_tag;
  using value_type = char;
  using difference_type = std::ptrdiff_t;
  using pointer = const char*;
  using reference = char;

  LineIterator(const char* at, int* line_read) : at_(at), line_read_(line_read) {}

  char operator*() const {
    *line_read_ = line_;
    return *at_;
  }
  LineIterator& operator++() {
    if (*at_++ == '\n') ++line_;
    return *this;
  }
  bool operator==(const LineIterator& other) const { return at_ == other.at_; }
  bool operator!=(const LineIterator& other) const { return at_ != other.at_; }

 private:
  const char* at_;
  int* line_read_;
  int line_ = 1;
};

/// Builds a tree from SAX events. Pointers in `open_` stay valid: only the innermost open node
/// grows.
class TreeBuilder : public nlohmann::json_sax<nlohmann::json> {
 public:
  TreeBuilder(LocatedJson& out, const std::string& file, const int& line)
      : out_(out), file_(file), line_(line) {}

  bool null() override { return add(nullptr); }
  bool boolean(bool value) override { return add(value); }
  bool number_integer(number_integer_t value) override { return add(value); }
  bool number_unsigned(number_unsigned_t value) override { return add(value); }
  bool number_float(number_float_t value, const string_t&) override { return add(value); }
  bool string(string_t& value) override { return add(std::move(value)); }
  bool binary(binary_t&) override { return false; }  // JSON text has none
  bool start_object(std::size_t) override { return open(nlohmann::json::object()); }
  bool start_array(std::size_t) override { return open(nlohmann::json::array()); }
  bool end_object() override { return close(); }
  bool end_array() override { return close(); }

  bool key(string_t& name) override {
    key_ = name;
    key_line_ = line_;
    return true;
  }

  bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception& e) override {
    return fail(is_key_outside() ? "a key stands outside of { }; write { ... } around everything"
                                 : syntax_words(e.what()));
  }

 private:
  bool add(nlohmann::json value) {
    place(std::move(value));
    return true;
  }

  bool open(nlohmann::json value) {
    if (open_.size() == max_depth) return fail("nested too deeply; 16 levels are allowed");
    open_.push_back(&place(std::move(value)));
    return true;
  }

  bool close() {
    drop_repeated_keys(*open_.back());
    open_.pop_back();
    return true;
  }

  JsonNode& place(nlohmann::json value) {
    const int line = key_line_ > 0 ? std::exchange(key_line_, 0) : line_;
    JsonNode node{std::exchange(key_, {}), {file_, line}, std::move(value), {}};
    if (open_.empty()) return out_.root = std::move(node);
    return open_.back()->children.emplace_back(std::move(node));
  }

  void drop_repeated_keys(JsonNode& object) {
    if (!object.value.is_object()) return;
    std::map<std::string, int> lines;
    std::vector<JsonNode> kept;
    for (JsonNode& child : object.children) {
      const auto [first, is_new] = lines.emplace(child.key, child.place.line);
      if (is_new) {
        kept.push_back(std::move(child));
      } else {
        out_.problems.push_back({file_, child.place.line, path() + child.key,
                                 "is already set in line " + std::to_string(first->second) +
                                     "; each key once is allowed"});
      }
    }
    object.children = std::move(kept);
  }

  /// The path of the innermost open object, with a dot at its end.
  std::string path() const {
    std::string result;
    for (std::size_t i = 1; i < open_.size(); ++i) {
      const JsonNode& parent = *open_[i - 1];
      if (parent.value.is_array()) {
        if (!result.empty()) result.pop_back();
        result += "[" + std::to_string(parent.children.size() - 1) + "].";
      } else {
        result += open_[i]->key + ".";
      }
    }
    return result;
  }

  /// Recognizes `"broker": {...}` pasted without braces: the key alone is then the whole document.
  bool is_key_outside() const { return open_.empty() && out_.root.value.is_string(); }

  bool fail(std::string words) {
    out_.problems = {{file_, line_, "syntax", std::move(words)}};
    return false;
  }

  LocatedJson& out_;
  const std::string& file_;
  const int& line_;
  std::vector<JsonNode*> open_;
  std::string key_;
  int key_line_ = 0;
};

}  // namespace

LocatedJson read_located_json(std::string_view text, const std::string& file) {
  LocatedJson result;
  if (const std::size_t null = text.find('\0'); null != text.npos) {  // ends the text for the lexer
    const auto line = 1 + std::ranges::count(text.substr(0, null), '\n');
    result.problems.push_back({file, static_cast<int>(line), "syntax",
                               "a null character; write the file again, as plain text"});
    return result;
  }
  int line = 1;
  TreeBuilder builder(result, file, line);
  const char* end = text.data() + text.size();
  result.is_complete =
      nlohmann::json::sax_parse(LineIterator(text.data(), &line), LineIterator(end, &line),
                                &builder, nlohmann::json::input_format_t::json,
                                true /* nothing after the value */, true /* with comments */);
  return result;
}

std::optional<std::vector<JsonNode>> read_group(std::string_view text, const std::string& file,
                                                std::string_view shape, Problems& problems) {
  if (text.find_first_not_of(" \t\r\n") == text.npos) {
    problems.push_back({file, 1, "syntax", fmt::format("the file is empty; allowed: {}", shape)});
    return std::nullopt;
  }
  LocatedJson document = read_located_json(text, file);
  std::ranges::move(document.problems, std::back_inserter(problems));
  if (!document.is_complete) return std::nullopt;
  if (document.root.value.is_object()) return std::move(document.root.children);
  problems.push_back(
      {file, document.root.place.line, "syntax", "is not a group; allowed: " + std::string(shape)});
  return std::nullopt;
}

void overlay(JsonNode& base, JsonNode over) {
  if (!base.value.is_object() || !over.value.is_object()) {
    base = std::move(over);
    return;
  }
  for (JsonNode& child : over.children) {
    const auto below = std::find_if(base.children.begin(), base.children.end(),
                                    [&](const JsonNode& node) { return node.key == child.key; });
    if (below == base.children.end()) {
      base.children.push_back(std::move(child));
    } else {
      overlay(*below, std::move(child));
    }
  }
}

}  // namespace slamgw
