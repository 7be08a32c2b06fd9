// SPDX-License-Identifier: Apache-2.0
// The interface through which the control socket passes requests to the daemon. Implemented by App,
// and by a fake in tests. Events for `watch` go the other way, as TraceEvent
// (daemon/core/trace.hpp), through ControlServer::publish.
#pragma once

#include <functional>
#include <string>

#include "daemon/control/wire.hpp"

namespace slamgw {

class ControlHandler {
 public:
  /// Takes the answer: result_line(), order_line() or error_line() of wire.hpp.
  using Answer = std::function<void(const std::string& line)>;

  virtual ~ControlHandler() = default;
  /// Carries out a request of an operator, `who` in the audit trail. `answer` is called once, now
  /// or minutes later. A WatchRequest never comes here.
  virtual void on_request(const std::string& who, control::Request request, Answer answer) = 0;
  /// Called when the first watcher has come, and when the last watcher has gone.
  virtual void on_watched(bool is_watched) = 0;
};

}  // namespace slamgw
