// SPDX-License-Identifier: Apache-2.0
// A session store in memory, which keeps sessions when an adapter is destroyed.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/session_store.hpp"

namespace slamgw::test {

class MemorySessionStore final : public SessionStore {
 public:
  std::vector<Session> load() override {
    std::vector<Session> all;
    for (const auto& [id, content] : sessions) all.push_back({id, content});
    return all;
  }
  void save(std::vector<Change> changes) override {
    for (Change& change : changes) {
      if (change.content) {
        sessions[change.id] = std::move(*change.content);
      } else {
        sessions.erase(change.id);
      }
    }
    if (on_written_) on_written_(true);
  }
  bool is_busy() const override { return false; }
  void watch(std::function<void(bool)> on_written) override { on_written_ = std::move(on_written); }

  std::map<std::string, Bytes> sessions;

 private:
  std::function<void(bool)> on_written_;
};

}  // namespace slamgw::test
