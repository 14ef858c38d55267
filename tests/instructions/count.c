/* Counts the instructions that a program executes under QEMU's user emulation, for processors that valgrind does not run on
 * here; prints the number at the end. QEMU's packages have no plugins and no header: what is needed of the interface
 * (version 1, QEMU 4.2 to 8.2) stands below.
 *
 *   gcc -shared -fPIC -O2 -o count.so tests/instructions/count.c
 *   qemu-aarch64 -L /usr/aarch64-linux-gnu -plugin ./count.so PROGRAM ARGUMENTS...
 */
#include <inttypes.h>
#include <stddef.h>
#include <stdio.h>

typedef uint64_t plugin_id;
struct qemu_plugin_tb;
enum { ADD_U64 };

void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, void (*)(plugin_id, struct qemu_plugin_tb *));
void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *, int, void *, uint64_t);
void qemu_plugin_register_atexit_cb(plugin_id, void (*)(plugin_id, void *), void *);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);

int qemu_plugin_version = 1;

/* Of all threads together: exact for programs of one thread alone. */
static uint64_t executed;

static void translated(plugin_id id, struct qemu_plugin_tb *block) {
  (void)id;
  qemu_plugin_register_vcpu_tb_exec_inline(block, ADD_U64, &executed, qemu_plugin_tb_n_insns(block));
}

static void at_exit(plugin_id id, void *unused) {
  (void)id;
  (void)unused;
  fprintf(stderr, "%" PRIu64 " instructions\n", executed);
}

int qemu_plugin_install(plugin_id id, const void *info, int count, char **arguments) {
  (void)info;
  (void)count;
  (void)arguments;
  qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
  qemu_plugin_register_atexit_cb(id, at_exit, NULL);
  return 0;
}
