// Computes the problems of a file (tests/test_native_same_bytes.py) and writes the bytes of the results: the kernel as
// an executable, which an emulator of another processor can run.
#include "../../needlefit/mechanics/native/abi.cpp"

extern "C" {
using Size = decltype(sizeof 0);  // on Windows no `unsigned long`
void* fopen(const char*, const char*);
Size fread(void*, Size, Size, void*);
Size fwrite(const void*, Size, Size, void*);
int fclose(void*);
void* calloc(Size, Size);
void free(void*);
}

struct Reader {
    void* file;
    Index number() {
        Index value = -1;
        return fread(&value, 8, 1, file) == 1 ? value : -1;
    }
    // An array: its bytes, after their number; null if there is none.
    void* array() {
        Index bytes = number();
        if (bytes <= 0) return nullptr;
        void* found = calloc(bytes, 1);
        fread(found, 1, bytes, file);
        return found;
    }
};

int main(int, char** arguments) {
    Reader in{fopen(arguments[1], "rb")};
    void* out = fopen(arguments[2], "wb");
    constexpr int ARRAYS = 19, OUTPUTS = 12;
    for (Index points = in.number(); points >= 0; points = in.number()) {
        Problem problem;
        constexpr Index head = sizeof(Problem) - ARRAYS * sizeof(void*);
        fread(&problem, 1, head, in.file);
        void* arrays[ARRAYS];
        for (auto& array : arrays) array = in.array();
        __builtin_memcpy(reinterpret_cast<char*>(&problem) + head, arrays, sizeof arrays);
        Index wanted = in.number() / 8;
        double* s = static_cast<double*>(calloc(wanted, 8));
        fread(s, 8, wanted, in.file);
        Index sizes[3];
        if (nf_check(&problem, sizes)) return 1;
        double* x = static_cast<double*>(calloc(sizes[0], 8));
        Index room = nf_nodes(&problem, x), sets = problem.sets, columns = problem.columns;
        free(x);
        Index planes = problem.planes, by = planes * columns;
        Index counts[OUTPUTS] = {room, planes * room, planes * room, (1 + planes) * points, 2 * planes * points, 1, 1, 0,
                                 room * by, room * by, points * by, points * by};
        void* outputs[OUTPUTS];
        for (int i = 0; i < OUTPUTS; i++) counts[i] = i == 7 ? 8 : 8 * sets * counts[i], outputs[i] = calloc(counts[i] + 8, 1);
        Shapes shapes{room, points};
        __builtin_memcpy(&shapes.x, outputs, sizeof outputs);
        char* memory = static_cast<char*>(calloc(nf_memory(&problem, LANES) + 64, 1));
        char* aligned = Arena{memory}.take<char>(1);
        for (Index first = 0; first < sets; first += LANES)
            if (nf_simulate(&problem, first, LANES, aligned, &shapes)) return 1;
        for (int i = 0; i < OUTPUTS; i++) fwrite(outputs[i], 1, counts[i], out);
        // The positions of each needle alone, since lanes must not matter.
        Index nodes = *shapes.nodes;
        double *room_of_shapes = static_cast<double*>(calloc((1 + 5 * planes) * (nodes + 2) * LANES + 8, 8));
        double *positions = static_cast<double*>(calloc((1 + planes) * wanted, 8));
        double *u = static_cast<double*>(calloc(2 * planes * nodes, 8)), *slope = u + planes * nodes;
        for (Index set = 0; set < sets; set++) {
            for (Index plane = 0; plane < planes; plane++)
                for (Index i = 0; i < nodes; i++) {
                    u[plane * nodes + i] = shapes.u[(plane * sets + set) * room + i];
                    slope[plane * nodes + i] = shapes.slope[(plane * sets + set) * room + i];
                }
            nf_positions(planes, 1, nodes, wanted, shapes.x + set * room, u, slope, s,
                         reinterpret_cast<char*>(room_of_shapes), positions);
            fwrite(positions, 8 * (1 + planes), wanted, out);
        }
        free(u);
        for (void* array : arrays) free(array);
        for (void* array : outputs) free(array);
        free(memory), free(s), free(room_of_shapes), free(positions);
    }
    fclose(out);
    return 0;
}
