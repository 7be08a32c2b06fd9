// SPDX-License-Identifier: Apache-2.0
// What has to be said to the socket of the broker's connection, which Paho keeps to itself.
#pragma once

#include <atomic>
#include <cstdint>

namespace slamgw {

class BrokerSocket {
 public:
  BrokerSocket() = default;
  ~BrokerSocket() { forget(); }
  BrokerSocket(const BrokerSocket&) = delete;
  BrokerSocket& operator=(const BrokerSocket&) = delete;

  /// Takes this process's connection to that port and sets TCP_NODELAY, which Paho does not: with
  /// Nagle's algorithm a message waits until the broker has acknowledged the TCP segment before, at
  /// QoS 0 for up to 40 ms. Any thread, once.
  void adopt(std::uint16_t broker_port);
  /// What is written from now on goes out together, when it is released (the kernel waits 200 ms at
  /// most). Nothing happens before adopt(). Any thread.
  void gather() { cork(1); }
  void release() { cork(0); }
  /// What the kernel has not sent yet is thrown away when the connection is closed.
  void discard_on_close();
  /// Not while gather() or release() may run.
  void forget();

 private:
  void cork(int on);

  /// A duplicate: Paho closes its own when it likes, and the number may then be another file's.
  std::atomic<int> descriptor_{-1};
};

}  // namespace slamgw
