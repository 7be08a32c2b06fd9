// SPDX-License-Identifier: Apache-2.0
// Keeps the sessions of a mesh's robots over a restart of the daemon (docs/topics.md, promise 7).
// Only the mesh knows what a session contains. All calls on the loop's thread.
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

  /// Loads all kept sessions. Call once, before the first save; blocks while the disk is read.
  virtual std::vector<Session> load() = 0;
  /// Takes the changes over and never blocks. Changes that can't be written now are written later.
  virtual void save(std::vector<Change> changes) = 0;
  /// True while changes are being written: the caller may wait and collect more of them.
  virtual bool is_busy() const = 0;
  /// Calls `on_written` after each try to write, with false when the try failed and is repeated.
  /// Written changes survive any end of the process. `on_written` may be empty.
  virtual void watch(std::function<void(bool is_written)> on_written) = 0;
};

}  // namespace slamgw
