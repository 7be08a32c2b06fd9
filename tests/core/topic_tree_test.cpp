// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/topic_tree.hpp"

#include <gtest/gtest.h>

#include <set>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw {
namespace {

std::set<std::string> matches(const TopicTree<std::string>& tree, std::string_view topic) {
  std::set<std::string> found;
  tree.match(topic, [&](const std::string& filter) {
    EXPECT_TRUE(found.insert(filter).second) << filter << " is visited twice";
  });
  return found;
}

TEST(TopicTree, FindsExactlyWhatTheFiltersMatch) {
  const std::vector<std::string> filters{"a",   "a/b", "a/+", "a/#",   "+",  "+/b",  "#", "a/+/c",
                                         "a//", "/a",  "+/+", "a/b/#", "$x", "$x/#", "/", "+/#"};
  TopicTree<std::string> tree;
  for (const std::string& filter : filters) tree[filter] = filter;
  for (const std::string topic : {"a", "a/b", "a/b/c", "a/", "a//", "/", "/a", "b", "b/b", "$x",
                                  "$x/y", "a/x/c", "a/b/c/d"}) {
    std::set<std::string> expected;
    for (const std::string& filter : filters) {
      if (filter_matches(filter, topic)) expected.insert(filter);
    }
    EXPECT_EQ(matches(tree, topic), expected) << topic;
  }
}

TEST(TopicTree, ForgetsAFilterAndNothingElse) {
  TopicTree<std::string> tree;
  for (const char* filter : {"a", "a/b", "a/b/c", "a/#"}) tree[filter] = filter;
  tree.erase("a/b");
  tree.erase("not/there");
  tree.erase("a/b");
  EXPECT_EQ(tree.find("a/b"), nullptr);
  EXPECT_EQ(matches(tree, "a/b"), std::set<std::string>{"a/#"});
  EXPECT_EQ(matches(tree, "a/b/c"), (std::set<std::string>{"a/#", "a/b/c"}));
  ASSERT_NE(tree.find("a"), nullptr);
  tree.clear();
  EXPECT_TRUE(matches(tree, "a").empty());
}

TEST(TopicTree, ForgetsFiltersThatEndInAWildcardOneByOne) {
  std::vector<std::string> filters{"a", "a/+", "a/#", "+", "#", "a/b", "a/b/+", "+/#", "a/+/c"};
  TopicTree<std::string> tree;
  for (const std::string& filter : filters) tree[filter] = filter;
  while (!filters.empty()) {
    tree.erase(filters.front());
    EXPECT_EQ(tree.find(filters.front()), nullptr) << filters.front();
    filters.erase(filters.begin());
    for (const std::string topic : {"a", "b", "a/b", "a/x", "a/b/x", "a/b/c", "x/y"}) {
      std::set<std::string> expected;
      for (const std::string& filter : filters) {
        if (filter_matches(filter, topic)) expected.insert(filter);
      }
      EXPECT_EQ(matches(tree, topic), expected) << topic << " without the first ones";
    }
  }
}

}  // namespace
}  // namespace slamgw
