#!/usr/bin/env bash
# Run tests of the mechanics with the kernel under AddressSanitizer and UndefinedBehaviorSanitizer (needs g++):
#     tests/native/sanitize.sh [arguments of pytest]
# Without arguments: all tests of the mechanics and of the kernel. PYTHON names the interpreter.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

place="$(mktemp -d)"
trap 'rm -rf "$place"' EXIT
g++ -std=c++20 -O1 -g -ffp-contract=off -fno-exceptions -fno-rtti -fno-threadsafe-statics -fno-math-errno -Wno-psabi \
    -fsanitize=address,undefined -fno-sanitize-recover=undefined -shared -fPIC \
    needlefit/mechanics/native/abi.cpp -o "$place/kernel.so"
if [ $# -eq 0 ]; then
    set -- tests/test_mechanics_*.py tests/test_native.py
fi
# Python itself leaks; the runtimes of the sanitizers have to be loaded before it. Their reports must not be captured.
ASAN_OPTIONS=detect_leaks=0 LD_PRELOAD="$(g++ -print-file-name=libasan.so) $(g++ -print-file-name=libubsan.so)" \
    NEEDLEFIT_LIBRARY="$place/kernel.so" "${PYTHON:-python}" -m pytest --capture=sys "$@"
