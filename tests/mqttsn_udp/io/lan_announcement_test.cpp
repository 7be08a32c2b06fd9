// SPDX-License-Identifier: Apache-2.0
// The announcement by DNS-SD, over a private D-Bus daemon, against a fake avahi-daemon. The fake
// answers like Avahi 0.8 (avahi-daemon/dbus-protocol.c, dbus-entry-group.c).
#include "adapters/mqttsn_udp/io/lan_announcement.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "tests/support/eventually.hpp"
#include "tests/support/private_bus.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr const char* group_path = "/Client1/EntryGroup1";
constexpr const char* group_interface = "org.freedesktop.Avahi.EntryGroup";

class FakeAvahi {
 public:
  explicit FakeAvahi(std::string address) : address_(std::move(address)) {}

  void come() {
    bus_ = test::connect_to_bus(address_);
    ASSERT_TRUE(bus_);
    sd_bus* const made = bus_.get();
    sd_bus_add_object_vtable(made, nullptr, "/", "org.freedesktop.Avahi.Server", server, this);
    sd_bus_add_object_vtable(made, nullptr, group_path, group_interface, group, this);
    sd_bus_match_signal(made, nullptr, "org.freedesktop.DBus", nullptr, nullptr, "NameOwnerChanged",
                        on_owner_changed, this);
    ASSERT_GE(sd_bus_request_name(made, "org.freedesktop.Avahi", 0), 0);
  }
  void leave() {
    bus_.reset();
    forget_client();
  }
  void process() {
    while (bus_ && sd_bus_process(bus_.get(), nullptr) > 0) {
    }
  }
  /// Changes the host's name: Avahi removes all services, and their programs add them again.
  void change_host_name() {
    announced.clear();
    sd_bus_emit_signal(bus_.get(), "/", "org.freedesktop.Avahi.Server", "StateChanged", "is", 2,
                       "org.freedesktop.Avahi.Success");
  }

  std::set<std::string> taken_here;  ///< names of other services of this host
  std::set<std::string> taken_on_lan;
  bool is_failing = false;
  std::vector<std::string> announced;  ///< "name type port interface protocol"

 private:
  static FakeAvahi& self(void* avahi) { return *static_cast<FakeAvahi*>(avahi); }
  void forget_client() {
    client_.clear();
    entry_.clear();
    announced.clear();
  }
  void say_state(int state, const char* error) {
    sd_bus_message* made = nullptr;
    sd_bus_message_new_signal(bus_.get(), &made, group_path, group_interface, "StateChanged");
    const SdBusMessage signal(made);
    sd_bus_message_append(made, "is", state, error);
    sd_bus_message_set_destination(made, client_.c_str());
    sd_bus_send(bus_.get(), made, nullptr);
  }
  static int refuse(sd_bus_message* call, const char* error) {
    return sd_bus_reply_method_errorf(call, error, "%s", error);
  }
  static int on_new(sd_bus_message* call, void* avahi, sd_bus_error*) {
    self(avahi).client_ = sd_bus_message_get_sender(call);
    return sd_bus_reply_method_return(call, "o", group_path);
  }
  static int on_reset(sd_bus_message* call, void* avahi, sd_bus_error*) {
    self(avahi).entry_.clear();
    self(avahi).announced.clear();
    return sd_bus_reply_method_return(call, "");
  }
  static int on_add(sd_bus_message* call, void* avahi, sd_bus_error*) {
    int interface = 0;
    int protocol = 0;
    unsigned flags = 0;
    const char *name = nullptr, *type = nullptr, *domain = nullptr, *host = nullptr;
    std::uint16_t port = 0;
    EXPECT_GT(sd_bus_message_read(call, "iiussssq", &interface, &protocol, &flags, &name, &type,
                                  &domain, &host, &port),
              0);
    EXPECT_EQ(self(avahi).client_, sd_bus_message_get_sender(call));
    if (self(avahi).taken_here.contains(name))
      return refuse(call, "org.freedesktop.Avahi.CollisionError");
    if (self(avahi).is_failing) return refuse(call, "org.freedesktop.Avahi.TooManyEntriesError");
    self(avahi).name_ = name;
    self(avahi).entry_ = std::string(name) + " " + type + " " + std::to_string(port) + " " +
                         std::to_string(interface) + " " + std::to_string(protocol);
    return sd_bus_reply_method_return(call, "");
  }
  static int on_commit(sd_bus_message* call, void* avahi, sd_bus_error*) {
    if (self(avahi).entry_.empty()) return refuse(call, "org.freedesktop.Avahi.IsEmptyError");
    self(avahi).say_state(1, "org.freedesktop.Avahi.Success");
    if (self(avahi).taken_on_lan.contains(self(avahi).name_)) {
      self(avahi).say_state(3, "org.freedesktop.Avahi.CollisionError");
    } else {
      self(avahi).announced = {self(avahi).entry_};
      self(avahi).say_state(2, "org.freedesktop.Avahi.Success");
    }
    return sd_bus_reply_method_return(call, "");
  }
  static int on_owner_changed(sd_bus_message* message, void* avahi, sd_bus_error*) {
    const char *name = nullptr, *before = nullptr, *after = nullptr;
    sd_bus_message_read(message, "sss", &name, &before, &after);
    if (self(avahi).client_ == name && *after == '\0') self(avahi).forget_client();
    return 0;
  }
  static constexpr sd_bus_vtable server[] = {
      SD_BUS_VTABLE_START(0),
      SD_BUS_METHOD("EntryGroupNew", "", "o", on_new, SD_BUS_VTABLE_UNPRIVILEGED),
      SD_BUS_VTABLE_END};
  static constexpr sd_bus_vtable group[] = {
      SD_BUS_VTABLE_START(0), SD_BUS_METHOD("Reset", "", "", on_reset, SD_BUS_VTABLE_UNPRIVILEGED),
      SD_BUS_METHOD("AddService", "iiussssqaay", "", on_add, SD_BUS_VTABLE_UNPRIVILEGED),
      SD_BUS_METHOD("Commit", "", "", on_commit, SD_BUS_VTABLE_UNPRIVILEGED), SD_BUS_VTABLE_END};

  std::string address_;
  SdBus bus_;
  std::string client_;  ///< the announcement's connection
  std::string name_;
  std::string entry_;  ///< added, not yet committed
};

class LanAnnouncementTest : public testing::Test {
 protected:
  LanAnnouncementTest() { bus.emplace(directory / "bus"); }
  bool eventually(const std::function<bool()>& condition) {
    return test::eventually(io, [&] {
      avahi.process();
      return condition();
    });
  }
  bool announces(const std::string& what) {
    return eventually([&] { return avahi.announced == std::vector<std::string>{what}; });
  }
  /// Returns the number of log lines with this text.
  long lines(std::string_view text) const {
    return std::ranges::count_if(
        log, [&](const std::string& line) { return line.find(text) != line.npos; });
  }

  boost::asio::io_context io;
  test::TempDir directory;
  std::optional<test::PrivateBus> bus;
  FakeAvahi avahi{test::PrivateBus::address_of(directory / "bus")};
  std::vector<std::string> log;
  std::optional<LanAnnouncement> announcement{
      std::in_place, io, test::PrivateBus::address_of(directory / "bus"),
      [this](const Notice& notice) { log.push_back(notice.text); }};
};

TEST_F(LanAnnouncementTest, AnnouncesThePortUntilItIsWithdrawn) {
  avahi.come();
  announcement->announce({"slam-gateway pi", 47193});
  EXPECT_TRUE(announces("slam-gateway pi _mqttsn._udp 47193 -1 -1"));
  EXPECT_TRUE(eventually([&] { return lines("as 'slam-gateway pi' (_mqttsn._udp, port 47193)"); }));
  announcement->announce({"slam-gateway pi", 5000, 3, true});
  EXPECT_TRUE(announces("slam-gateway pi _mqttsn._udp 5000 3 0"));
  announcement->withdraw();
  EXPECT_TRUE(eventually([&] { return avahi.announced.empty(); }));
}

TEST_F(LanAnnouncementTest, WithdrawsTheServiceWhenDestroyed) {
  avahi.come();
  announcement->announce({"pi", 47193});
  ASSERT_TRUE(announces("pi _mqttsn._udp 47193 -1 -1"));
  announcement.reset();
  EXPECT_TRUE(eventually([&] { return avahi.announced.empty(); }));
}

TEST_F(LanAnnouncementTest, WaitsForAvahiAndFollowsItsRestarts) {
  announcement->announce({"pi", 47193});
  ASSERT_TRUE(eventually([&] { return lines("avahi-daemon is not running") == 1; }));
  for (const long restarts : {1, 2}) {
    avahi.come();
    ASSERT_TRUE(announces("pi _mqttsn._udp 47193 -1 -1"));
    ASSERT_TRUE(eventually([&] { return lines("is announced") == restarts; }));
    avahi.leave();
    ASSERT_TRUE(eventually([&] { return lines("is not running") == restarts + 1; }));
  }
}

TEST_F(LanAnnouncementTest, ReportsAMissingBusOnceAndRetries) {
  bus.reset();
  announcement->announce({"pi", 47193});
  EXPECT_EQ(lines("the system bus is not available"), 1);
  bus.emplace(directory / "bus");
  avahi.come();
  EXPECT_TRUE(announces("pi _mqttsn._udp 47193 -1 -1"));
  EXPECT_EQ(lines("the system bus is not available"), 1);
}

TEST_F(LanAnnouncementTest, ChoosesAnotherNameWhenTheNameIsTaken) {
  avahi.taken_here = {"pi"};
  avahi.taken_on_lan = {"pi #2", "pi #3"};
  avahi.come();
  announcement->announce({"pi", 47193});
  EXPECT_TRUE(announces("pi #4 _mqttsn._udp 47193 -1 -1"));
  EXPECT_TRUE(eventually([&] { return lines("as 'pi #4'") == 1; }));
  avahi.taken_here.clear();
  avahi.change_host_name();
  avahi.taken_on_lan = {"pi"};
  EXPECT_TRUE(announces("pi #2 _mqttsn._udp 47193 -1 -1"))
      << "tries the names from the first one again";
}

TEST_F(LanAnnouncementTest, GivesUpWhenAllNamesAreTaken) {
  avahi.taken_here = {"pi"};
  for (int number = 2; number <= LanAnnouncement::max_names; ++number)
    avahi.taken_on_lan.insert("pi #" + std::to_string(number));
  avahi.come();
  announcement->announce({"pi", 47193});
  EXPECT_TRUE(eventually([&] { return lines("20 names like 'pi' are taken") == 1; }));
}

TEST_F(LanAnnouncementTest, ReportsARefusalByAvahiAndRetries) {
  avahi.is_failing = true;
  avahi.come();
  announcement->announce({"pi", 47193});
  EXPECT_TRUE(eventually([&] { return lines("Avahi refused the service: ") == 1; }));
  avahi.is_failing = false;
  avahi.change_host_name();
  EXPECT_TRUE(announces("pi _mqttsn._udp 47193 -1 -1"));
}

}  // namespace
}  // namespace slamgw::mqttsn
