// SPDX-License-Identifier: Apache-2.0
// Text shown on terminals cannot move the cursor nor reverse the direction of the text.
#include "daemon/core/utf8.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include <fstream>
#include <string>
#include <utility>
#include <vector>

namespace slamgw {
namespace {

TEST(EscapeUnprintable, LeavesOrdinaryTextAlone) {
  for (const std::string_view text : {"", "Gr\u00fc\u00dfe \U0001f916", "a b\"c\\"}) {
    EXPECT_TRUE(is_printable(text)) << text;
    EXPECT_EQ(escape_unprintable(text), text);
  }
}

TEST(EscapeUnprintable, EscapesControlAndDirectionCharacters) {
  EXPECT_EQ(escape_unprintable("a\x1b[2Jb\n"), "a\\x1b[2Jb\\x0a");
  EXPECT_EQ(escape_unprintable("\u009b1m"), "\\u009b1m");
  EXPECT_EQ(escape_unprintable("\x7f"), "\\u007f");
  EXPECT_EQ(escape_unprintable("a\u202eb\u2069\u200f\u061c\u2028"),
            "a\\u202eb\\u2069\\u200f\\u061c\\u2028");
  EXPECT_EQ(escape_unprintable("\xff\xc3"), "\\xff\\xc3");
}

TEST(EscapeUnprintable, EscapesCharactersThatMakeNamesLookAlike) {
  std::ifstream file(SLAMGW_SOURCE_DIR "/tests/vectors/shown.json");
  for (const auto& [text, shown] :
       nlohmann::json::parse(file).get<std::vector<std::pair<std::string, std::string>>>()) {
    EXPECT_EQ(escape_unprintable(text), shown);
    EXPECT_EQ(escape_unprintable(shown), shown);
    const nlohmann::json document{{"id", text}};
    EXPECT_EQ(nlohmann::json::parse(escape_unprintable(document.dump())), document);
  }
}

TEST(EscapeUnprintable, KeepsAJsonDocumentTheSame) {
  const nlohmann::json document{{"id", "a\u202e\u009b\x7f\x1b\n\"\\"}};
  const std::string shown = escape_unprintable(document.dump());
  EXPECT_TRUE(is_printable(shown)) << shown;
  EXPECT_EQ(nlohmann::json::parse(shown), document);
}

}  // namespace
}  // namespace slamgw
