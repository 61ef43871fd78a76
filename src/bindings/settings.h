// Settings of C, read from a dictionary by the names of their members; members.py lists these for `MEMBER`.
#pragma once
#include <nanobind/nanobind.h>

#include <stdexcept>
#include <string>
#include <type_traits>

// What is not given stays as it was; an entry that is no member is refused by `finish`.
class Reader {
  public:
    explicit Reader(const nanobind::dict &entries) : entries_(entries) {}

    template <typename T> void operator()(const char *name, T &member) {
        if (!entries_.contains(name)) return;
        known_++;
        read(name, entries_[name], member);
    }

    void finish() const {
        if (known_ != entries_.size())
            throw nanobind::type_error("settings have an entry that the kernel has not: it was compiled from another header");
    }

  private:
    template <typename T> static void read(const char *name, nanobind::handle value, T &member) {
        if constexpr (std::is_array_v<T>) {
            size_t count = 0;
            for (nanobind::handle entry : nanobind::cast<nanobind::iterable>(value)) {
                if (count == std::extent_v<T>)
                    throw std::invalid_argument(std::string(name) + ": the kernel holds at most " +
                                                std::to_string(count) + " entries");
                read(name, entry, member[count++]);
            }
        } else if constexpr (std::is_floating_point_v<T>) {
            member = static_cast<T>(nanobind::cast<double>(value));
        } else if constexpr (std::is_enum_v<T>) {
            member = static_cast<T>(nanobind::cast<int>(value));
        } else {
            member = nanobind::cast<T>(value);
        }
    }

    const nanobind::dict &entries_;
    size_t known_ = 0;
};
