// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/web_server.hpp"

#include <boost/asio/ip/address.hpp>
#include <chrono>
#include <sstream>
#include <string>

#include "daemon/config/rules.hpp"
#include "web/server/io/http_connection.hpp"

namespace slamgw::web {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;

constexpr std::chrono::milliseconds pause_after_failure{200};

tcp::endpoint endpoint_of(const std::string& listen) {
  const auto [address, port] = listen_parts(listen);
  return {asio::ip::make_address(address), port};
}

Client client_at(const asio::ip::address& address) {
  if (address.is_v4()) return client_of(address.to_v4().to_bytes());
  return client_of(address.to_v6().to_bytes());
}

}  // namespace

WebServer::WebServer(asio::io_context& io, const Settings& settings, PageHub& hub)
    : hub_(hub),
      answers_(AccessRules(settings.hosts)),
      acceptor_(io, endpoint_of(settings.listen)),
      pause_(io) {
  accept();
}

std::string WebServer::address() const {
  std::ostringstream out;
  out << acceptor_.local_endpoint();
  return out.str();
}

void WebServer::accept() {
  acceptor_.async_accept([this](boost::system::error_code error, tcp::socket socket) {
    if (error == asio::error::operation_aborted) return;
    if (!error) {
      admit(std::move(socket));
      return accept();
    }
    pause_.after(pause_after_failure, [this] { accept(); });
  });
}

void WebServer::admit(tcp::socket socket) {
  boost::system::error_code error;
  const asio::ip::address address = socket.remote_endpoint(error).address();
  if (error) return;  // the client has gone already
  const Client client = client_at(address);
  const Places::Room room = places_.room_for(client);
  if (room == Places::Room::share_is_taken) hub_.report_taken_share(client);
  if (room != Places::Room::free) hub_.count_refused_request();  // this one, or the one it replaces
  if (!places_.make_room_for(client)) return;
  std::make_shared<HttpConnection>(std::move(socket), *this, client)->read();
}

}  // namespace slamgw::web
