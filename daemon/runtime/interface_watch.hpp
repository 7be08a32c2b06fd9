// SPDX-License-Identifier: Apache-2.0
// Reports that network interfaces or their addresses appear, disappear or change (rtnetlink). The
// caller has to find out what has changed. Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <functional>
#include <memory>

namespace slamgw {

class InterfaceWatch : public std::enable_shared_from_this<InterfaceWatch> {
 public:
  explicit InterfaceWatch(boost::asio::io_context& io);

  /// Calls `on_change` from now on, once for many changes at a time. Returns false, and calls
  /// nothing, when the kernel refuses the socket.
  bool start(std::function<void()> on_change);
  void stop();

 private:
  void wait();
  void drain();

  boost::asio::posix::stream_descriptor socket_;
  std::function<void()> on_change_;
};

}  // namespace slamgw
