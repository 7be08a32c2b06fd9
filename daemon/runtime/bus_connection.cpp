// SPDX-License-Identifier: Apache-2.0
#include "daemon/runtime/bus_connection.hpp"

#include <fcntl.h>
#include <poll.h>

#include <boost/asio/post.hpp>
#include <cerrno>
#include <cstring>
#include <utility>

namespace slamgw {
namespace {

namespace asio = boost::asio;

constexpr const char* bus_name = "org.freedesktop.DBus";
constexpr const char* bus_path = "/org/freedesktop/DBus";

}  // namespace

BusConnection::BusConnection(asio::io_context& io, std::string address, std::string service,
                             Handlers handlers)
    : io_(io),
      address_(std::move(address)),
      service_(std::move(service)),
      handlers_(std::move(handlers)),
      timer_(io) {}

void BusConnection::open() {
  life_ = std::make_shared<char>();
  const int error = connect();
  error < 0 ? fail(error) : watch();
}

int BusConnection::connect() {
  sd_bus* made = nullptr;
  const int failure = address_.empty() ? sd_bus_open_system(&made) : sd_bus_new(&made);
  if (failure < 0) return failure;
  bus_.reset(made);
  if (!address_.empty()) {
    sd_bus_set_address(made, address_.c_str());
    sd_bus_set_bus_client(made, 1);
    if (const int error = sd_bus_start(made); error < 0) return error;
  }
  if (handlers_.on_opened)
    if (const int error = handlers_.on_opened(made); error < 0) return error;
  const int error = sd_bus_match_signal_async(made, nullptr, bus_name, bus_path, bus_name,
                                              "NameOwnerChanged", on_owner_changed, nullptr, this);
  if (error < 0) return error;
  const int socket = ::fcntl(sd_bus_get_fd(made), F_DUPFD_CLOEXEC, 0);
  if (socket < 0) return -errno;
  socket_.emplace(io_, socket);
  return sd_bus_call_method_async(made, nullptr, bus_name, bus_path, bus_name, "GetNameOwner",
                                  on_owner, this, "s", service_.c_str());
}

void BusConnection::close() {
  life_.reset();
  timer_.cancel();
  socket_.reset();
  is_reading_ = is_writing_ = false;
  bus_.reset();
  owner_.clear();
}

void BusConnection::fail(int error) {
  reopen();
  handlers_.on_service(std::string("the system bus is not available: ") + std::strerror(-error));
}

void BusConnection::reopen() {
  close();
  life_ = std::make_shared<char>();
  timer_.after(reopen_after, [this] { open(); });
}

/// Waits for the socket and the deadline for which sd-bus waits.
void BusConnection::watch() {
  if (!socket_) return;
  const auto on_wait = [this, life = std::weak_ptr(life_)](bool& is_waiting) {
    return [this, life, &is_waiting](boost::system::error_code error) {
      if (life.expired() || error == asio::error::operation_aborted) return;
      is_waiting = false;
      on_ready();
    };
  };
  const int events = sd_bus_get_events(bus_.get());
  if (events < 0) return fail(events);
  if (!std::exchange(is_reading_, true))
    socket_->async_wait(asio::posix::descriptor_base::wait_read, on_wait(is_reading_));
  if ((events & POLLOUT) != 0 && !std::exchange(is_writing_, true))
    socket_->async_wait(asio::posix::descriptor_base::wait_write, on_wait(is_writing_));
  std::uint64_t due_us = 0;
  if (sd_bus_get_timeout(bus_.get(), &due_us) < 0 || due_us == UINT64_MAX) return;
  const auto due = std::chrono::microseconds(static_cast<std::int64_t>(due_us));
  timer_.at(TimePoint(due), [this] { on_ready(); });
}

void BusConnection::on_ready() {
  const std::weak_ptr<void> life = life_;
  for (int count = 0; count < max_at_once; ++count) {
    const int result = sd_bus_process(bus_.get(), nullptr);
    if (life.expired()) return;  // a callback has closed the connection
    if (result < 0) return fail(result);
    if (result == 0) return watch();
  }
  post([this] { on_ready(); });
}

void BusConnection::post(std::function<void()> task) {
  asio::post(io_, [life = std::weak_ptr(life_), task = std::move(task)] {
    if (!life.expired()) task();
  });
}

SdBusMessage BusConnection::call(const char* path, const char* interface,
                                 const char* member) const {
  sd_bus_message* made = nullptr;
  sd_bus_message_new_method_call(bus_.get(), &made, owner_.c_str(), path, interface, member);
  return SdBusMessage(made);
}

void BusConnection::set_owner(std::string owner) {
  if (owner == owner_) return;
  owner_ = std::move(owner);
  handlers_.on_service({});
}

int BusConnection::on_owner_changed(sd_bus_message* message, void* self, sd_bus_error*) {
  BusConnection& connection = *static_cast<BusConnection*>(self);
  const char *name = nullptr, *before = nullptr, *after = nullptr;
  if (sd_bus_message_read(message, "sss", &name, &before, &after) > 0 &&
      name == connection.service_)
    connection.set_owner(after);
  return 0;
}

int BusConnection::on_owner(sd_bus_message* message, void* self, sd_bus_error*) {
  BusConnection& connection = *static_cast<BusConnection*>(self);
  const char* owner = "";
  if (sd_bus_message_is_method_error(message, nullptr) <= 0)
    sd_bus_message_read(message, "s", &owner);
  if (*owner != '\0') {
    connection.set_owner(owner);
  } else if (connection.owner_.empty()) {
    connection.handlers_.on_service({});
  }
  return 0;
}

}  // namespace slamgw
