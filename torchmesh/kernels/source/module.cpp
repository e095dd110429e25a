// What the linker of Windows looks for in every extension of Python.  Nobody imports the library: ctypes loads it.
#include "common.hpp"

TM_EXPORT void* PyInit__loops() { return nullptr; }
