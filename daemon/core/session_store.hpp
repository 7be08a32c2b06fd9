// SPDX-License-Identifier: Apache-2.0
// Where a mesh keeps the sessions of its robots over a restart of the daemon (docs/topics.md,
// promise 7). What a session is made of is the mesh's concern. All calls on the loop's thread.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/bytes.hpp"

namespace slamgw {

class SessionStore {
 public:
  struct Session {
    std::string id;
    Bytes content;
  };
  struct Change {
    std::string id;
    std::optional<Bytes> content;  ///< nothing: the session has ended
  };

  virtual ~SessionStore() = default;

  /// Loads all kept sessions. Once, before the first save; takes as long as the disk takes.
  virtual std::vector<Session> load() = 0;
  /// Takes the changes over and never blocks; what can't be written now is written later.
  virtual void save(std::vector<Change> changes) = 0;
  /// True while changes are being written: the caller may wait and collect more of them.
  virtual bool is_busy() const = 0;
  /// `on_written` is called after each try to write, with false when it failed and is repeated.
  /// What is written survives any end of the process. It may be empty.
  virtual void watch(std::function<void(bool is_written)> on_written) = 0;
};

}  // namespace slamgw
