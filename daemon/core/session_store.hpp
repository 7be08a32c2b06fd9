// SPDX-License-Identifier: Apache-2.0
// Where a mesh keeps the sessions of its robots over a restart of the daemon (contract section 6,
// promise 7). What a session is made of is the mesh's concern. All calls on the loop's thread.
#pragma once

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

  /// All that is kept. Once, before the first save; may take as long as the disk takes.
  virtual std::vector<Session> load() = 0;
  /// Takes the changes over and never blocks; what can't be written now is written later.
  virtual void save(std::vector<Change> changes) = 0;
  /// The last changes are not written yet: the next ones may wait, and be fewer.
  virtual bool is_busy() const = 0;
};

}  // namespace slamgw
