// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/located_json.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <limits>
#include <sstream>
#include <utility>
#include <vector>

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

/// The parser's input, which knows the line of the last character that was read. The parser also
/// reads the character after a number, which is still on the number's line.
class Input {
 public:
  explicit Input(std::string_view text) : text_(text), stream_(std::string(text)) {}

  std::istream& stream() { return stream_; }
  int line() {
    const auto read = stream_.rdbuf()->pubseekoff(0, std::ios::cur, std::ios::in);
    for (; counted_ + 1 < read; ++counted_)
      line_ += text_[static_cast<std::size_t>(counted_)] == '\n';
    return line_;
  }

 private:
  std::string_view text_;
  std::istringstream stream_;
  std::streamoff counted_ = 0;
  int line_ = 1;
};

/// Follows the parser from value to value: notes lines, and refuses what nlohmann-json accepts.
class Follower {
 public:
  Follower(LocatedJson& out, Input& input) : out_(out), input_(input) {}

  /// Returns false for a key that the parser must leave out. `depth`: 0 for the whole document.
  bool on_event(std::size_t depth, Json::parse_event_t event, const Json& parsed) {
    using Event = Json::parse_event_t;
    if (event == Event::object_end || event == Event::array_end || depth > left_out_) return true;
    if (depth < left_out_) left_out_ = nothing;
    if (event == Event::key) return on_key(depth, parsed.get_ref<const std::string&>());
    if (depth == 0) out_.line = input_.line();
    if (depth == 0) is_text_ = parsed.is_string();
    if (depth > 0 && open_[depth - 1].is_list) on_element(depth);
    if (event == Event::value) return true;
    if (depth == max_depth) throw TooDeep();
    open_.resize(depth);
    open_.push_back({depth == 0 ? "" : path_, event == Event::array_start, 0, {}});
    return true;
  }

  /// Recognizes `"broker": {...}` pasted without braces: the key alone is then the whole document.
  bool is_text() const { return is_text_; }

  struct TooDeep {};

 private:
  static constexpr std::size_t nothing = std::numeric_limits<std::size_t>::max();

  /// A group or a list around the value that is being read.
  struct Open {
    std::string path;
    bool is_list = false;
    std::size_t count = 0;              ///< of a list
    std::map<std::string, int> keys{};  ///< of a group, with their lines
  };

  bool on_key(std::size_t depth, const std::string& key) {
    const std::string& group = open_[depth - 1].path;
    path_ = group.empty() ? key : group + "." + key;
    out_.lines.emplace(path_, input_.line());
    const auto [first, is_new] = open_[depth - 1].keys.emplace(key, input_.line());
    left_out_ = is_new ? nothing : depth;
    if (!is_new)
      out_.problems.push_back(
          {out_.file, input_.line(), path_,
           fmt::format("is already set in line {}; each key once is allowed", first->second)});
    return is_new;
  }

  void on_element(std::size_t depth) {
    path_ = fmt::format("{}[{}]", open_[depth - 1].path, open_[depth - 1].count++);
    out_.lines.emplace(path_, input_.line());
  }

  LocatedJson& out_;
  Input& input_;
  std::vector<Open> open_;
  std::string path_;                ///< of the newest key or element
  std::size_t left_out_ = nothing;  ///< the depth of a repeated key, while its value is read
  bool is_text_ = false;
};

}  // namespace

LocatedJson read_located_json(std::string_view text, const std::string& file) {
  LocatedJson result{file, {}, 1, {}, false, {}};
  const auto fail = [&](int line, std::string words) {
    result.problems = {{file, line, "syntax", std::move(words)}};
    return result;
  };
  if (const std::size_t null = text.find('\0'); null != text.npos)  // ends the text for the lexer
    return fail(1 + static_cast<int>(std::ranges::count(text.substr(0, null), '\n')),
                "a null character; write the file again, as plain text");
  Input input(text);
  Follower follower(result, input);
  try {
    result.root = Json::parse(
        input.stream(),
        [&follower](int depth, Json::parse_event_t event, const Json& parsed) {
          return follower.on_event(static_cast<std::size_t>(depth), event, parsed);
        },
        true /* throws */, true /* with comments */);
  } catch (const Follower::TooDeep&) {
    return fail(input.line(), "nested too deeply; 16 levels are allowed");
  } catch (const Json::exception& error) {
    return fail(input.line(), follower.is_text()
                                  ? "a key stands outside of { }; write { ... } around everything"
                                  : syntax_words(error.what()));
  }
  result.is_complete = true;
  return result;
}

std::optional<LocatedJson> read_group(std::string_view text, const std::string& file,
                                      std::string_view shape, Problems& problems) {
  if (text.find_first_not_of(" \t\r\n") == text.npos) {
    problems.push_back({file, 1, "syntax", fmt::format("the file is empty; allowed: {}", shape)});
    return std::nullopt;
  }
  LocatedJson document = read_located_json(text, file);
  problems.insert(problems.end(), document.problems.begin(), document.problems.end());
  if (!document.is_complete) return std::nullopt;
  if (document.root.is_object()) return document;
  problems.push_back(
      {file, document.line, "syntax", "is not a group; allowed: " + std::string(shape)});
  return std::nullopt;
}

}  // namespace slamgw
