// A C struct of calls, handed from one extension module to another.
#pragma once
#include <nanobind/nanobind.h>

// In a capsule that keeps `owner`, the object that the calls act on, alive.
template <typename Calls> nanobind::capsule in_capsule(const char *name, const Calls &calls, nanobind::object owner) {
    struct Held {
        Calls calls; // first, so that the capsule points at it
        nanobind::object owner;
    };
    return nanobind::capsule(new Held{calls, owner}, name, [](void *p) noexcept { delete static_cast<Held *>(p); });
}

// Back from the capsule; ValueError where it holds something else.
template <typename Calls> const Calls &from_capsule(const char *name, nanobind::handle capsule) {
    void *p = PyCapsule_GetPointer(capsule.ptr(), name);
    if (!p) throw nanobind::python_error();
    return *static_cast<const Calls *>(p);
}
