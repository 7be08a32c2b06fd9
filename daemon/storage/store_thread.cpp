// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/store_thread.hpp"

namespace slamgw {

StoreThread::StoreThread(boost::asio::io_context& loop)
    : loop_(loop),
      work_(boost::asio::make_work_guard(context_)),
      thread_([this] { context_.run(); }) {}

StoreThread::~StoreThread() { stop(); }

void StoreThread::stop() {
  if (!thread_.joinable()) return;
  *is_stopped_ = true;
  run([this] { context_.stop(); });
  thread_.join();
}

}  // namespace slamgw
