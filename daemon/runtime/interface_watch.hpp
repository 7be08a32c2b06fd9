// SPDX-License-Identifier: Apache-2.0
// Tells when network interfaces or their addresses come, go or change (rtnetlink). What that means
// is for the caller to find out. Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <functional>
#include <memory>

namespace slamgw {

class InterfaceWatch : public std::enable_shared_from_this<InterfaceWatch> {
 public:
  explicit InterfaceWatch(boost::asio::io_context& io);

  /// From now on `on_change` is called, once for many changes at a time. False where the kernel has
  /// no such socket for us; nothing is called then.
  bool start(std::function<void()> on_change);
  void stop();

 private:
  void wait();
  void drain();

  boost::asio::posix::stream_descriptor socket_;
  std::function<void()> on_change_;
};

}  // namespace slamgw
