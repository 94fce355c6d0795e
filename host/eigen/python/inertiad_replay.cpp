// SPDX-License-Identifier: Apache-2.0
/// Python module inertiad_replay: read a candump log, and hand bytes to file descriptors each at its own time.
///
/// The player knows nothing of CAN or LCM: an item is a piece of a buffer, a descriptor and an instant of
/// CLOCK_MONOTONIC. Waiting is absolute, so lateness never adds up; what is due together on one socket goes out in one
/// sendmmsg(). The last stretch before an instant is waited for actively, since a sleeping thread wakes late.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <poll.h>
#include <string>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
#include <vector>

extern "C" {
#include "candump.h"
}

namespace nb = nanobind;
using namespace nb::literals;

namespace {

// ---- candump log ----------------------------------------------------------------------------------------------------

/// A vector as a numpy array that owns it, of the given shape.
template <typename T>
nb::ndarray<nb::numpy, T> to_numpy(std::vector<T>&& values, std::initializer_list<std::size_t> shape)
{
    auto* kept = new std::vector<T>(std::move(values));
    nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return {kept->data(), shape.size(), std::data(shape), owner};
}

struct Log {
    std::vector<int64_t> t_ns;
    std::vector<uint32_t> can_id;
    std::vector<uint8_t> flags, length, bus, data;
    std::vector<std::string> name;
    std::size_t width = 8;
    std::size_t n_lines = 0, n_bad = 0, n_reported_lost = 0, first_bad = 0;
    std::string first_reason;

    /// Make room for FD frames in every row read so far.
    void widen()
    {
        std::vector<uint8_t> wide(t_ns.size() * IPE_DATA_MAX, 0);
        for (std::size_t k = 0; k < t_ns.size(); ++k) { std::copy_n(&data[8 * k], 8, &wide[IPE_DATA_MAX * k]); }
        data.swap(wide);
        width = IPE_DATA_MAX;
    }

    uint8_t bus_of(const ipe_candump_name_t& n)
    {
        const std::string text(n.text, n.length);
        const auto found = std::find(name.begin(), name.end(), text);
        if (found != name.end()) { return static_cast<uint8_t>(found - name.begin()); }
        if (name.size() == 255) { throw std::invalid_argument("more than 255 interfaces in one log"); }
        name.push_back(text);
        return static_cast<uint8_t>(name.size() - 1);
    }

    void add(const ipe_frame_t& frame, uint8_t on_bus)
    {
        if (frame.length > width) { widen(); }
        t_ns.push_back(frame.t_ns);
        can_id.push_back(frame.can_id);
        flags.push_back(frame.flags);
        length.push_back(frame.length);
        bus.push_back(on_bus);
        data.insert(data.end(), frame.data, frame.data + width);
    }

    void line(const char* text, std::size_t n)
    {
        ipe_frame_t frame{};
        ipe_candump_name_t interface{};
        uint64_t n_lost = 0;
        ++n_lines;
        const ipe_candump_t result = ipe_candump_parse(text, n, &frame, &interface, &n_lost);
        n_reported_lost += n_lost;
        if (result == IPE_CANDUMP_FRAME) { add(frame, bus_of(interface)); }
        if (result <= IPE_CANDUMP_DROPS) { return; }
        if (n_bad++ > 0) { return; }
        first_bad = n_lines;
        first_reason = ipe_candump_reason(result);
    }
};

/// Bytes that are not UTF-8 become replacement characters.
nb::list texts(const std::vector<std::string>& names)
{
    nb::list found;
    for (const std::string& name : names) {
        found.append(nb::steal(PyUnicode_DecodeUTF8(name.data(), static_cast<Py_ssize_t>(name.size()), "replace")));
    }
    return found;
}

nb::dict parse_candump(const nb::bytes& bytes)
{
    Log log;
    {
        const char* at = bytes.c_str();
        const char* const end = at + bytes.size();
        nb::gil_scoped_release released;
        while (at < end) {
            const char* stop = static_cast<const char*>(std::memchr(at, '\n', static_cast<std::size_t>(end - at)));
            if (stop == nullptr) { stop = end; }
            const std::size_t n = static_cast<std::size_t>(stop - at);
            log.line(at, n > 0 && at[n - 1] == '\r' ? n - 1 : n);
            at = stop + 1;
        }
    }
    const std::size_t n = log.t_ns.size(), width = log.width;
    nb::dict d;
    d["t_ns"] = to_numpy(std::move(log.t_ns), {n}), d["can_id"] = to_numpy(std::move(log.can_id), {n});
    d["flags"] = to_numpy(std::move(log.flags), {n}), d["length"] = to_numpy(std::move(log.length), {n});
    d["bus"] = to_numpy(std::move(log.bus), {n}), d["data"] = to_numpy(std::move(log.data), {n, width});
    d["names"] = texts(log.name), d["n_lines"] = log.n_lines, d["n_bad"] = log.n_bad;
    d["n_reported_lost"] = log.n_reported_lost, d["first_bad"] = log.first_bad, d["first_reason"] = log.first_reason;
    return d;
}

// ---- player ---------------------------------------------------------------------------------------------------------

constexpr int64_t NS_PER_S = 1000000000;
constexpr int64_t LONGEST_SLEEP_NS = 50000000;  // Ctrl-C is looked at in between
constexpr int64_t NO_ROOM_NS = 200000;          // a full CAN queue is tried again after this
constexpr std::size_t BATCH = 64;

int64_t now_ns()
{
    timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return int64_t{t.tv_sec} * NS_PER_S + t.tv_nsec;
}

void sleep_until(int64_t t_ns)
{
    const timespec t{.tv_sec = t_ns / NS_PER_S, .tv_nsec = t_ns % NS_PER_S};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr);
}

template <typename T>
using In = nb::ndarray<const T, nb::numpy, nb::c_contig, nb::device::cpu, nb::ndim<1>>;

/// The items of one run and what has become of them.
class Player {
public:
    Player(const In<uint8_t>& data, const In<int64_t>& begin, const In<int64_t>& due_ns, const In<uint8_t>& route,
           const std::vector<int>& fds, int64_t start_ns, int64_t spin_ns)
        : data_(data.data()), begin_(begin.data()), due_ns_(due_ns.data()), route_(route.data()), n_(due_ns.shape(0)),
          fds_(fds), start_ns_(start_ns), spin_ns_(spin_ns)
    {
        if (begin.shape(0) != n_ + 1 || route.shape(0) != n_) {
            throw std::invalid_argument("begin, route: wrong length");
        }
        for (std::size_t k = 0; k < n_; ++k) {
            if (route_[k] >= fds_.size()) { throw std::invalid_argument("route: no such descriptor"); }
            if (begin_[k] > begin_[k + 1] || begin_[k] < 0) { throw std::invalid_argument("begin: must not decrease"); }
        }
        if (n_ > 0 && static_cast<std::size_t>(begin_[n_]) > data.shape(0)) {
            throw std::invalid_argument("begin: past data");
        }
        for (const int fd : fds_) { is_socket_.push_back(is_datagram_socket(fd)); }
        const int64_t latest_ns = INT64_MAX / 2;
        if (start_ns < 0 || start_ns > latest_ns || spin_ns < 0 || spin_ns > latest_ns) {
            throw std::invalid_argument("start_ns, spin_ns: out of range");
        }
        for (std::size_t k = 0; k < n_; ++k) {
            if (due_ns_[k] < 0 || due_ns_[k] > latest_ns) { throw std::invalid_argument("due_ns: out of range"); }
        }
        lateness_ns_.reserve(n_);
    }

    void play()
    {
        prctl(PR_SET_TIMERSLACK, 1UL);
        for (std::size_t k = 0; k < n_ && !is_stopped_;) {
            wait_until(start_ns_ + due_ns_[k]);
            if (is_stopped_) { break; }
            const std::size_t end = due_together(k);
            const std::size_t n_sent = is_socket_[route_[k]] ? send_datagrams(k, end) : write_stream(k, end);
            const int64_t done_ns = now_ns();
            for (std::size_t i = k; i < k + n_sent; ++i) { lateness_ns_.push_back(done_ns - start_ns_ - due_ns_[i]); }
            k += n_sent;
        }
    }

    nb::dict result()
    {
        nb::dict d;
        const std::size_t n = lateness_ns_.size();
        d["lateness_ns"] = to_numpy(std::move(lateness_ns_), {n});
        d["n_waits"] = n_waits_, d["is_interrupted"] = is_interrupted_, d["error"] = error_, d["route"] = failed_route_;
        return d;
    }

private:
    static bool is_datagram_socket(int fd)
    {
        int type = 0;
        socklen_t size = sizeof type;
        return getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &size) == 0 && type != SOCK_STREAM;
    }

    void look_for_interrupt()
    {
        nb::gil_scoped_acquire acquired;
        if (PyErr_CheckSignals() == 0) { return; }
        PyErr_Clear();
        is_stopped_ = is_interrupted_ = true;
    }

    void wait_until(int64_t t_ns)
    {
        int64_t now = now_ns();
        if (now - looked_ns_ > LONGEST_SLEEP_NS) {
            looked_ns_ = now;
            look_for_interrupt();
        }
        while (!is_stopped_ && t_ns - spin_ns_ > now) {
            sleep_until(std::min(t_ns - spin_ns_, now + LONGEST_SLEEP_NS));
            now = now_ns();
            if (t_ns - spin_ns_ > now) { look_for_interrupt(); }
        }
        while (!is_stopped_ && now < t_ns) { now = now_ns(); }
    }

    /// One past the last item, from k on, that goes to the same place and is due by now.
    std::size_t due_together(std::size_t k) const
    {
        const int64_t now = now_ns();
        std::size_t end = k + 1;
        while (end < n_ && end - k < BATCH && route_[end] == route_[k] && start_ns_ + due_ns_[end] <= now) { ++end; }
        return end;
    }

    /// After a failed call: true when it may be tried again.
    bool may_retry(std::size_t k)
    {
        if (errno == EINTR) { return true; }
        if (errno == EAGAIN || errno == ENOBUFS) {
            ++n_waits_;
            pollfd p{.fd = fds_[route_[k]], .events = POLLOUT, .revents = 0};
            if (errno == ENOBUFS || poll(&p, 1, 50) < 0) { sleep_until(now_ns() + NO_ROOM_NS); }
            look_for_interrupt();
            return !is_stopped_;
        }
        error_ = errno;
        failed_route_ = route_[k];
        is_stopped_ = true;
        return false;
    }

    const uint8_t* at(std::size_t k) const { return data_ + begin_[k]; }
    std::size_t size(std::size_t k) const { return static_cast<std::size_t>(begin_[k + 1] - begin_[k]); }

    std::size_t send_datagrams(std::size_t k, std::size_t end)
    {
        mmsghdr message[BATCH];
        iovec part[BATCH];
        const std::size_t n = end - k;
        for (std::size_t i = 0; i < n; ++i) {
            part[i] = {const_cast<uint8_t*>(at(k + i)), size(k + i)};
            message[i] = {};
            message[i].msg_hdr.msg_iov = &part[i];
            message[i].msg_hdr.msg_iovlen = 1;
        }
        for (;;) {
            const int sent = sendmmsg(fds_[route_[k]], message, static_cast<unsigned>(n), MSG_NOSIGNAL);
            if (sent > 0) { return static_cast<std::size_t>(sent); }
            if (sent < 0 && errno == ECONNREFUSED) { continue; }  // UDP: nobody listened to the one before
            if (!may_retry(k)) { return 0; }
        }
    }

    std::size_t write_stream(std::size_t k, std::size_t end)
    {
        const uint8_t* from = at(k);
        const uint8_t* const to = at(end - 1) + size(end - 1);
        while (from < to) {
            const ssize_t n = ::write(fds_[route_[k]], from, static_cast<std::size_t>(to - from));
            if (n >= 0) { from += n; }
            if (n < 0 && !may_retry(k)) { return 0; }
        }
        return end - k;
    }

    const uint8_t* data_;
    const int64_t* begin_;
    const int64_t* due_ns_;
    const uint8_t* route_;
    std::size_t n_;
    std::vector<int> fds_;
    std::vector<bool> is_socket_;
    int64_t start_ns_, spin_ns_, looked_ns_ = 0;
    std::vector<int64_t> lateness_ns_;
    uint64_t n_waits_ = 0;
    int error_ = 0, failed_route_ = 0;
    bool is_stopped_ = false, is_interrupted_ = false;
};

nb::dict play(const In<uint8_t>& data, const In<int64_t>& begin, const In<int64_t>& due_ns, const In<uint8_t>& route,
              const std::vector<int>& fds, int64_t start_ns, int64_t spin_ns)
{
    Player player(data, begin, due_ns, route, fds, start_ns, spin_ns);
    {
        nb::gil_scoped_release released;
        player.play();
    }
    return player.result();
}

}  // namespace

NB_MODULE(inertiad_replay, m)
{
    nb::set_leak_warnings(false);
    m.doc() = "Read a candump log, and write bytes to descriptors each at its own time.";
    m.def(
        "parse_candump", &parse_candump, "data"_a,
        "Frames of a candump log in the order of the file: dict of t_ns, can_id, flags, length, bus [N], data [N, 8 or 64], "
        "names (interface of each bus), n_lines, n_bad, first_bad (line number), first_reason, n_reported_lost. candump.h");
    m.def(
        "play", &play, "data"_a, "begin"_a, "due_ns"_a, "route"_a, "fds"_a, "start_ns"_a, "spin_ns"_a,
        "Write data[begin[k]:begin[k + 1]] to fds[route[k]] at start_ns + due_ns[k] of CLOCK_MONOTONIC, for k = 0 .. N - 1; "
        "spin_ns before each instant is waited for actively. dict of lateness_ns [items sent] (after the call that sent "
        "it), n_waits (full queues), is_interrupted (Ctrl-C), error (errno, 0: none) and the route it came from.");
}
