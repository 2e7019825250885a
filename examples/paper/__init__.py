"""The paper's experiments, a module or package for each table or figure."""
