"""Problems of other projects, by the library and by rival methods: ``python -m examples.external``."""
