// SPDX-License-Identifier: Apache-2.0
// fuzz_NAME [CORPUS]: the target on every file of test/fuzz/corpus/NAME, one Unity test each; run at the top of the tree.
#define _GNU_SOURCE  // program_invocation_short_name
#include "fuzz.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <limits.h>

#include <unity.h>

enum { INPUT_MAX = 1 << 20, NAME_CHARS = 64 };

static char path[PATH_MAX];

void setUp(void)
{
}
void tearDown(void)
{
}

static void replay_file(void)
{
    static uint8_t input[INPUT_MAX];
    FILE* file = fopen(path, "rb");
    TEST_ASSERT_NOT_NULL_MESSAGE(file, path);
    const size_t n = fread(input, 1, sizeof input, file);
    TEST_ASSERT_TRUE_MESSAGE(feof(file) || n < sizeof input, "larger than INPUT_MAX");
    (void)fclose(file);
    uint8_t* exact = malloc(n > 0 ? n : 1);  // a read past its end is found
    TEST_ASSERT_NOT_NULL(exact);
    memcpy(exact, input, n);
    (void)LLVMFuzzerTestOneInput(exact, n);
    free(exact);
}

static int is_input(const struct dirent* entry)
{
    return entry->d_name[0] != '.';
}

int main(int argc, char** argv)
{
    char folder[PATH_MAX / 2];
    struct dirent** entry;
    const char* target = strchr(program_invocation_short_name, '_');
    (void)snprintf(folder, sizeof folder, "test/fuzz/corpus/%s", target != NULL ? target + 1 : "");
    if (argc > 1) { (void)snprintf(folder, sizeof folder, "%s", argv[1]); }
    UNITY_BEGIN();
    const int n = scandir(folder, &entry, is_input, alphasort);
    if (n < 0) { (void)fprintf(stderr, "%s: %s\n", folder, strerror(errno)); }
    for (int i = 0; i < n; ++i) {
        char name[NAME_CHARS];
        (void)snprintf(path, sizeof path, "%s/%s", folder, entry[i]->d_name);
        (void)snprintf(name, sizeof name, "%.*s", NAME_CHARS - 1, entry[i]->d_name);
        for (char* at = name; *at != '\0'; ++at) { *at = isalnum((unsigned char)*at) ? *at : '_'; }
        (void)printf("%s\n", path);  // should it crash
        (void)fflush(stdout);
        UnityDefaultTestRun(replay_file, name, __LINE__);
        free(entry[i]);
    }
    if (n >= 0) { free(entry); }
    return UNITY_END();
}
